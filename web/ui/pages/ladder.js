// The error ladder: effects added one after another while the error on unseen data falls.
import { html, useState } from '../html.js';
import { useResource, useList, post } from '../api.js';
import { hasEnded, useAfterJobs } from '../events.js';
import { sayFault } from '../say.js';
import { number, fixed, horizon, clock, plainly, NOISE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Status } from '../parts/status.js';
import { Empty, Failed, Loading } from '../parts/screens.js';
import { JobWatch } from '../parts/watch.js';
import { Table } from '../parts/table.js';
import { useAdoption } from '../parts/adopt.js';
import { grownFrom } from '../parts/experiment.js';
import { LadderChart } from '../charts/ladder.js';

export function LadderTab({ system, document, reload, changed }) {
  const path = `/systems/${system}/ladder`;
  const jobs = useList(`/jobs?system=${encodeURIComponent(system)}&kind=ladder`);
  // The job of the newest ladder is kept as long as that.
  const climbed = jobs.data?.some(job => job.state === 'succeeded') ?? false;
  const ladder = useResource(climbed ? path : null);
  const [started, setStarted] = useState(null);
  const running = started ?? jobs.data?.find(job => !hasEnded(job))?.id ?? null;
  // What is watched tells its end by itself.
  useAfterJobs(running ? null : system, jobs, ladder);
  const climb = () => post('/jobs', { kind: 'ladder', system }).then(job => setStarted(job.id), sayFault);
  const done = () => {
    setStarted(null);
    ladder.reload();
    jobs.reload();
  };
  const { error, reload: again } = jobs.error ? jobs : ladder;
  if (error) return html`<${Failed} error=${error} retry=${again} />`;
  if (!jobs.data || (climbed && !ladder.data)) return html`<${Loading} what="the ladder" />`;
  return html`
    ${running && html`<${JobWatch} key=${running} id=${running} title="Climbing the ladder" onEnd=${done} />`}
    ${
      !climbed &&
      !running &&
      html`<${Empty} title="No ladder yet">
        <p>The service starts with ${document.model} and adds the effect that helps most, again and again, while the error on unseen data falls.</p>
      <button class="main" onClick=${climb}>Climb the ladder</button></${Empty}>`
    }
    ${climbed && html`<${Ladder} data=${ladder.data} path=${path} climb=${running ? null : climb}
      adopting=${{ system, document, reload, changed }} />`}`;
}

/** `adopting` is what an adoption needs, nothing where no service is behind the page. */
export function Ladder({ data, path, climb, adopting }) {
  const fit = useResource(`/fits/${data.fit}`);
  const [metrics] = Object.values(fit.data?.metrics ?? {});
  const several = Object.keys(fit.data?.metrics ?? {}).length > 1;
  // Of several outputs the steps count all errors together, each in the noise of its sensor.
  const unit = several ? NOISE : (metrics?.unit ?? '');
  const adoption = useAdoption(adopting ?? {});
  const steps = data.steps.map(step => ({ ...step, label: step.added ? `+ ${step.added}` : step.model }));
  const kept = steps.filter(step => step.kept);
  const [first, last] = [kept[0], kept.at(-1)];
  const use = at => {
    const { model } = steps[at];
    // Only a last step is not kept, so that a model has the effects of all steps up to its own.
    const effects = steps.slice(1, at + 1).map(step => step.added);
    return () => adoption.use(model, () => grownFrom(first.model, effects));
  };
  const says =
    kept.length > 1
      ? `With ${kept
          .slice(1)
          .map(step => step.added)
          .join(' and ')} the error on unseen data falls${fall(first, last, unit)}.`
      : `The error did not fall: no effect that these data can show makes ${first.model} better on unseen data.`;
  return html`
    <div class="row apart"><p class="verdict"><${Status} of=${kept.length > 1 ? 'ok' : 'none'} label="" /> ${says}</p>
      ${climb && html`<button onClick=${climb}>Climb again</button>`}</div>
    <p class="quiet">${clock(data.created_at)}. A step is kept on the validation part; the test part is only reported.${
      several ? ' Errors of all outputs together, each in the noise of its sensor.' : ''
    }</p>
    <${Frame} title=${`Error ladder: rmse of the free run, ${unit}`} path=${path} summary=${says}
      table=${() => ({ columns: [['step'], ['train', 'number'], ['validation', 'number'], ['test', 'number'], ['bic', 'number'], ['kept'],
        ['why']], rows: steps.map(step => [step.label, number(step.train_rmse), number(step.validation_rmse), number(step.test_rmse),
          number(step.bic, 5), step.kept ? 'yes' : 'no', step.why]) })}>
      <${LadderChart} steps=${steps} unit=${unit} floor=${several ? null : metrics?.noise_floor}
        floorName=${`one-step error of ${first.model}`} label=${says} /></${Frame}>
    <${Table} caption="Steps" columns=${[['step'], ['train', 'number'], ['validation', 'number'], ['test', 'number'],
      ...Object.keys(first.ahead).map(key => [`${horizon(key)} ahead`, 'number']), ['kept'], ['why'], ...(adopting ? [['for the controller']] : [])]}
      rows=${steps.map((step, at) => [
        step.label,
        ...['train_rmse', 'validation_rmse', 'test_rmse'].map(key => `${fixed(step[key])} ${unit}`),
        ...Object.keys(first.ahead).map(key => `${fixed(step.ahead[key])} ${unit}`),
        html`<span class="nowrap"><${Status} of=${step.kept ? 'ok' : 'cancelled'} label=${step.kept ? 'kept' : 'not kept'} /></span>`,
        plainly(step.why),
        ...(adopting
          ? [
              step.model === adopting.document.model
                ? html`<span class="nowrap"><${Status} of="ok" label="the model of the system" /></span>`
                : html`<button aria-label=${`Use this model for the controller: ${step.model}`} onClick=${use(at)}>Use this model</button>`,
            ]
          : []),
      ])} />
    ${adoption.told}`;
}

/** Of the free run where it falls, or else of the forecasts that do, with what the free run does. */
function fall(first, last, unit) {
  const pair = (from, to) => ` from ${fixed(from)} to ${fixed(to)} ${unit}`;
  const [free, after] = [first.validation_rmse, last.validation_rmse];
  if (after < free) return pair(free, after);
  const ahead = ['PT24H', 'PT6H'].find(key => last.ahead[key] < first.ahead[key]);
  if (!ahead) return '';
  return ` for forecasts ${horizon(ahead)} ahead${pair(first.ahead[ahead], last.ahead[ahead])}; the free run goes${pair(free, after)}`;
}
