// Add an effect, watch the refit, see the error fall - or read that it did not. All of it on the page where one is.
import { html, useState, useEffect } from '../html.js';
import { ask, useResource } from '../api.js';
import { setQuery, here } from '../router.js';
import { number, fixed, horizon, titleFor } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Failed } from '../parts/screens.js';
import { useAdoption } from '../parts/adopt.js';
import { JobWatch } from '../parts/watch.js';
import { Equations } from '../parts/equations.js';
import { Status } from '../parts/status.js';
import { useTitles } from '../parts/names.js';
import { explained } from '../parts/term.js';
import { Outputs, outputIn } from '../parts/outputs.js';
import { experiment, grownBy, FALL } from '../parts/experiment.js';
import { LadderChart } from '../charts/ladder.js';
import { Overlay } from './overlay.js';

const all = (path, options) => Promise.all(path.split(',').map(id => ask(`/fits/${id}`, options)));

/** The errors of a fit as a step of the ladder. */
function stepOf(fit, before, output) {
  const metrics = fit.metrics[output] ?? Object.values(fit.metrics)[0];
  return {
    label: before
      ? `+ ${
          fit.model
            .split('+')
            .filter(part => !before.model.split('+').includes(part))
            .join(' + ') || fit.model
        }`
      : fit.model,
    ...metrics,
    unit: metrics.unit,
  };
}

/**
 * `effect` is what was asked for last, null for nothing; `grown` hears the model with all that was added; `steps` are the fits that the address carries, one per effect
 * that was added to the diagnosed model. Every step is judged on the split of the diagnosis, so that they compare.
 */
export function Adding({ diagnosis, system, document, effect, steps, taken, grown, reload, changed }) {
  const [change, setChange] = useState(null);
  const [error, setError] = useState(null);
  const adoption = useAdoption({ system, document, reload, changed });
  const job = useResource(`/jobs/${diagnosis.job}`);
  const known = [diagnosis.fit, ...steps].filter(Boolean);
  const fits = useResource(known.length ? known.join(',') : null, { read: all });
  const { adding } = here().query;
  const metrics = fits.data?.[0]?.metrics ?? {};
  const output = outputIn(here().query, metrics);
  const ready = job.data && (fits.data || known.length === 0);
  const current = fits.data?.at(-1)?.model ?? diagnosis.model;
  useEffect(() => grown(current), [current]);
  const add = async ({ effect: name, title }) => {
    taken();
    setError(null);
    adoption.forget();
    try {
      const model = await grownBy(current, name);
      const started = await experiment(system, model.id, job.data.request);
      setChange({ model, parent: current, title });
      setQuery({ adding: started.id }, { replace: false });
    } catch (fault) {
      setError(fault);
    }
  };
  useEffect(() => {
    if (effect && ready) add(effect);
  }, [effect, ready]);
  const ended = done => {
    if (!done.fit || steps.includes(done.fit)) return;
    setQuery({ steps: [...steps, done.fit].join(',') });
  };
  const undo = () => {
    setChange(null);
    adoption.forget();
    setQuery({ adding: null, steps: steps.slice(0, -1).join(',') || null });
  };
  if (!error && !effect && !adding && steps.length === 0) return null;
  const ladder = fits.data?.map((fit, at) => stepOf(fit, fits.data[at - 1], output)) ?? [];
  return html`<section aria-label="Add and refit">
    ${error && html`<${Failed} error=${error} />`}
    ${change && html`<${Equation} change=${change} />`}
    ${adding && html`<${JobWatch} key=${adding} id=${adding} title="Refit with the effect" onEnd=${ended} />`}
    ${ladder.length > 1 && html`<${Outputs} metrics=${metrics} query=${here().query} />`}
    ${ladder.length > 1 && html`<${Outcome} ladder=${ladder} model=${current} undo=${undo}
      serve=${document.model === current ? null : () => adoption.use(current)} />`}
    ${adoption.told}
    ${ladder.length > 1 && html`<${Overlay} before=${fits.data.at(-2)} after=${fits.data.at(-1)} output=${output}
      zone=${document.location?.zone ?? 'UTC'} />`}
    ${
      ladder.length > 1 &&
      html`<${Frame} title=${`Error ladder, what you added: rmse of the free run, ${ladder[0].unit}`} path=${`/fits/${steps.at(-1)}`}
        summary=${ladder.map(step => `${step.label}: train ${number(step.train_rmse)}, validation ${number(step.validation_rmse)}, test ${number(step.test_rmse)}`).join('; ')}
      table=${() => ({ columns: [['model'], ['train', 'number'], ['validation', 'number'], ['test', 'number']], rows: ladder.map(step =>
        [step.label, number(step.train_rmse), number(step.validation_rmse), number(step.test_rmse)]) })}>
      <${LadderChart} steps=${ladder} unit=${ladder[0].unit} floor=${Object.keys(metrics).length > 1 ? null : diagnosis.noise_floor_rmse}
        label="Train, validation and test error of each step" /></${Frame}>`
    }
  </section>`;
}

/** What the newest step did to the error, as plainly when it did nothing. */
function Outcome({ ladder, model, undo, serve }) {
  const [before, after] = ladder.slice(-2);
  const change = (key, name) =>
    Number.isFinite(before[key]) &&
    Number.isFinite(after[key]) &&
    html`<div><dt>${explained(name)}</dt><dd>${fixed(before[key])} → ${fixed(after[key])} ${after.unit}</dd></div>`;
  const fell = after.validation_rmse < before.validation_rmse * FALL;
  const overfit = !fell && after.train_rmse < before.train_rmse * FALL && after.validation_rmse > before.validation_rmse / FALL;
  const ahead = Object.keys(after.ahead ?? {}).filter(key => before.ahead?.[key]);
  const sooner = ahead.filter(key => after.ahead[key].rmse < before.ahead[key].rmse * 0.95);
  const pair = `${before.validation_rmse.toFixed(3)} → ${after.validation_rmse.toFixed(3)} ${after.unit}`;
  return html`<div class="outcome ${fell ? '' : 'bad'}" role="status">
    <p class="says"><${Status} of=${fell ? 'ok' : 'bad'} label=${
      fell
        ? `The error on unseen data fell by ${Math.round((1 - after.validation_rmse / before.validation_rmse) * 100)} %: ${pair}.`
        : `The error did not fall: ${pair} on unseen data.`
    } /></p>
    ${
      !fell &&
      html`<p>${overfit ? 'It fell on the data that were fitted only: what was learnt there does not repeat. ' : ''}The effect is not in these data, or they are too short to show it.
      ${sooner.length > 0 ? ` Forecasts ${sooner.map(horizon).join(' and ')} ahead did become better.` : ''}</p>`
    }
    <dl class="figures">${change('train_rmse', 'train')}${change('validation_rmse', 'validation')}${change('test_rmse', 'test, never used')}
      ${ahead.map(key => html`<div><dt>${explained(`${horizon(key)} ahead`)}</dt><dd>
        ${fixed(before.ahead[key].rmse)} → ${fixed(after.ahead[key].rmse)} ${after.unit}</dd></div>`)}</dl>
    <p class="row">${
      serve
        ? html`<button class=${fell ? 'main' : ''} onClick=${serve}>Use ${model} for the controller</button>`
        : html`<${Status} of="ok" label=${`${model} is the model of the system`} />`
    }
      ${serve && html`<button class=${fell ? '' : 'main'} onClick=${undo}>Take it out again</button>`}</p>
  </div>`;
}

/** The equations of the parent with what the effect adds, marked. */
function Equation({ change: { model, parent, title } }) {
  const { diff } = model;
  const titles = useTitles(model.id);
  return html`<div class="card"><h3>${parent} + ${title}</h3>
    <${Equations} model=${parent} diff=${diff} />
    <p class="note">New parameters: ${
      Object.entries(diff.parameters ?? {})
        .map(([name, entry]) => `${titleFor(name, titles) ?? entry.title} (${name}, ${entry.lower} to ${entry.upper} ${entry.unit})`)
        .join('; ') || 'none'
    }.</p>
  </div>`;
}
