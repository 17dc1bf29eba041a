// Which input to drive for a few days, so that what the data cannot tell apart can be told.
import { html, useMemo, useState } from '../html.js';
import { ask, curl, post, useResource } from '../api.js';
import { sayFault } from '../say.js';
import { number, clock, plainly, seconds, words } from '../format.js';
import { useTitles } from '../parts/names.js';
import { Frame, save } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Strips } from '../charts/strips.js';

/** Two nights, and what people call comfortable. */
const ASKED = { days: '2', low: '', high: '', coldest: '19', warmest: '23' };

/** A form below the pairs that cannot be told apart, and the plans that answer it. */
export function PlanExperiment({ fit, system, zone }) {
  const model = useResource(`/models/${encodeURIComponent(fit.model)}`);
  const inputs = (model.data?.inputs ?? []).map(input => input.channel);
  const [asked, setAsked] = useState(ASKED);
  const [plans, setPlans] = useState(null);
  const [busy, setBusy] = useState(false);
  if (fit.correlated.length === 0 || inputs.length === 0) return null;
  const pairs = fit.correlated.map(pair => pair.parameters);
  const about = pairs[Number(asked.pair ?? 0)];
  const input = asked.input ?? inputs[0];
  const output = Object.keys(fit.metrics)[0];
  const set = field => event => setAsked({ ...asked, [field]: event.target.value });
  const isBounded = asked.coldest !== '' && asked.warmest !== '';
  const body = {
    days: Number(asked.days),
    inputs: { [input]: [Number(asked.low), Number(asked.high)] },
    comfort: isBounded ? { [output]: [Number(asked.coldest), Number(asked.warmest)] } : {},
    to: 'separate',
    about,
  };
  const path = `/systems/${system}/experiments`;
  const plan = event => {
    event.preventDefault();
    setBusy(true);
    post(path, body)
      .then(found => setPlans({ found, body }), sayFault)
      .finally(() => setBusy(false));
  };
  const field = (title, name, more = {}) => html`<label>${title}<input type="number" step="any" value=${asked[name]} onInput=${set(name)} ...${more} /></label>`;
  return html`<details><summary>Plan an experiment that tells them apart</summary>
    <form class="card" onSubmit=${plan}>
      <div class="grid">
        <label>What to tell apart<select onChange=${set('pair')}>${pairs.map((pair, at) => html`<option value=${at}>${pair.join(' and ')}</option>`)}</select></label>
        <label>What may be driven<select onChange=${set('input')}>${inputs.map(name => html`<option value=${name}>${name}</option>`)}</select></label>
        ${field('Its lowest value', 'low', { required: true })}
        ${field('Its highest value', 'high', { required: true })}
        ${field(`${output}, at least`, 'coldest')}
        ${field(`${output}, at most`, 'warmest')}
        ${field('Days', 'days', { required: true, min: 1, max: 14, step: 1 })}
      </div>
      <p class="row end"><button class="main" disabled=${busy}>${busy ? 'Planning…' : 'Plan'}</button></p>
    </form>
    ${plans && html`<${Plans} found=${plans.found} body=${plans.body} path=${path} zone=${zone} model=${fit.model} />`}
  </details>`;
}

function Plans({ found, body, path, zone, model }) {
  const titles = useTitles(model);
  const time = useMemo(() => found.time.map(seconds), [found]);
  const told = says => plainly(says.replaceAll(/\d{4}-\d\d-\d\dT[\d:]+Z/g, at => clock(at, zone)), { titles });
  return html`<ul>${found.sentences.map(says => html`<li>${told(says)}</li>`)}</ul>
    ${found.plans.map(plan => html`<${Plan} key=${plan.family} plan=${plan} time=${time} found=${found} body=${body} path=${path} zone=${zone} told=${told} />`)}`;
}

function Plan({ plan, time, found, body, path, zone, told }) {
  const series = [...Object.entries(plan.inputs), ...Object.entries(plan.outputs)];
  const strips = series.map(([name, { unit, values, sd }]) => ({
    label: name,
    unit,
    height: 110,
    lines: [
      ...(sd ? [{ label: '95 %', colour: 'previous', min: values.map((value, at) => value - 1.96 * sd[at]), max: values.map((value, at) => value + 1.96 * sd[at]) }] : []),
      { label: sd ? 'expected' : 'to be driven', colour: sd ? 'model' : 'measured', values },
    ],
  }));
  const asked = { ...body, plan: plan.family };
  const table = () =>
    ask(path, { method: 'POST', body: asked, accept: 'text/csv' }).then(
      text => save(new Blob([text], { type: 'text/csv' }), `experiment-${plan.family}.csv`),
      sayFault,
    );
  const says = told(plan.sentence);
  const width = (lesson, value) => `${number(value)} ${lesson.width_unit}`;
  return html`<${Frame} title=${`A plan: ${words(plan.family)}`} path=${path} command=${curl(path, { method: 'POST', body: asked })} summary=${says} note=${says}
      table=${() => ({
        columns: [['time'], ...series.map(([name, { unit }]) => [`${name}, ${unit}`, 'number'])],
        rows: found.time.map((at, row) => [clock(at, zone), ...series.map(([, { values }]) => number(values[row], 4))]),
      })}>
      <${Strips} time=${time} strips=${strips} whole=${[time[0], time.at(-1)]} range=${null} zone=${zone} label=${says} onZoom=${() => {}} />
    </${Frame}>
    <${Table} caption="What it teaches" columns=${[['parameter'], ['width of its interval now', 'number'], ['behind it', 'number'], ['t now', 'number'], ['t behind it', 'number']]}
      rows=${plan.lessons.map(lesson => [lesson.parameter, width(lesson, lesson.width_before), width(lesson, lesson.width_after), number(lesson.t_before), number(lesson.t_after)])} />
    <p class="row end"><button onClick=${table}>CSV for the building automation</button></p>`;
}
