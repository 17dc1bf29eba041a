// Measured beside the model: where the line follows, and where it does not.
import { html, useMemo, useRef } from '../html.js';
import { ask, useResource, useList, withQuery } from '../api.js';
import { REPORT } from '../carried.js';
import { setQuery, systemAddress } from '../router.js';
import { useKeys } from '../keys.js';
import { number, instant, seconds, horizon, length, fitName, sentence, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Term } from '../parts/term.js';
import { Shown, Empty } from '../parts/screens.js';
import { Outputs, outputIn, forecasts, NO_FORECASTS } from '../parts/outputs.js';
import { Flowsheet } from '../parts/flowsheet.js';
import { linesOf, sampled } from '../charts/lines.js';
import { Strips } from '../charts/strips.js';
import { Errors, errorsInWords } from './errors.js';

const POINTS = 2000;
/** Most samples that one answer holds. */
const SAMPLES = 20_000;
const NO_OTHER = 'none';
const VIEWS = [
  ['free_run', 'Free run'],
  ['PT1H', '1 h ahead'],
  ['PT6H', '6 h ahead'],
  ['PT24H', '24 h ahead'],
];

/** Which run of the model the service is asked for. */
const runOf = query => (query.mode && query.mode !== 'free_run' ? { mode: 'ahead', horizon: query.mode } : { mode: 'free_run' });

/** The same with as many points as a chart needs. */
const viewOf = query => ({ ...runOf(query), max_points: POINTS });

/** Every sample between two instants as CSV, answer by answer. */
async function everySample(fit, query, [from, to], step) {
  const parts = [];
  for (let start = from; start <= to; start += SAMPLES * step) {
    const end = Math.min(start + (SAMPLES - 1) * step, to);
    const part = await ask(
      withQuery(`/fits/${fit}/comparison`, { ...runOf(query), max_points: SAMPLES, from: instant(start), to: instant(end) }),
      { accept: 'text/csv' },
    );
    parts.push(parts.length === 0 ? part : part.slice(part.indexOf('\n') + 1));
  }
  return parts.join('');
}

/** The values of another fit's line at these times, or nothing where most of them are others. */
function aligned(time, other, line) {
  const at = new Map(other.time.map((sampled, index) => [sampled, index]));
  if (time.filter(sampled => at.has(sampled)).length < time.length / 2) return null;
  const taken = values => time.map(sampled => (at.has(sampled) ? values[at.get(sampled)] : null));
  return Object.fromEntries(Object.entries(linesOf(line)).map(([kind, values]) => [kind, taken(values)]));
}

/** The value of an input that never changes, or null. */
function constantOf(input) {
  const [low, high] = input.values ? [input.values, input.values] : [input.min, input.max];
  return low.every(value => value === low[0]) && high.every(value => value === low[0]) ? low[0] : null;
}

/** Inputs that never change, as `S_I 30 g/m3`. */
const constants = data =>
  Object.entries(data.inputs)
    .filter(([, input]) => constantOf(input) !== null)
    .map(([name, input]) => `${name} ${number(constantOf(input))} ${input.unit}`);

/** The strips of a comparison: outputs with their residuals, then each input. One output alone is drawn larger. */
function stripsOf(data, previous, chosen) {
  const strips = [];
  const several = Object.keys(data.outputs).length > 1;
  const heights = several && !chosen ? [150, 64] : [260, 96];
  for (const [name, output] of Object.entries(data.outputs)) {
    if (chosen && name !== chosen) continue;
    const lines = [
      { label: 'measured', colour: 'measured', width: 1.6, ...sampled(linesOf(output.measured)) },
      { label: 'model', colour: 'model', width: 1.6, dash: [8, 3], ...linesOf(output.simulated) },
    ];
    const before = previous?.outputs[name] && aligned(data.time, previous, previous.outputs[name].simulated);
    if (before) lines.push({ label: 'the other', colour: 'previous', width: 1.6, dash: [2, 3], ...before });
    strips.push({ label: name, unit: output.unit, height: heights[0], lines });
    strips.push({
      label: several ? `${name}: measured − model` : 'residual: measured − model',
      unit: output.error_unit,
      height: heights[1],
      zero: true,
      lines: [{ label: 'residual', colour: 'heldout', width: 1.2, ...sampled(linesOf(output.residual)) }],
    });
  }
  for (const [name, input] of Object.entries(data.inputs)) {
    if (constantOf(input) !== null) continue;
    strips.push({ label: name, unit: input.unit, height: 62, lines: [{ label: name, colour: 'quiet', width: 1.2, ...linesOf(input) }] });
  }
  return strips;
}

/** The numbers of the chart within the shown range, those of the other fit among them where it is drawn. */
function tableOf(data, previous, [from, to]) {
  const columns = [['time']];
  const series = [];
  const add = (name, line) => {
    for (const [kind, values] of Object.entries(linesOf(line))) {
      columns.push([kind === 'values' ? name : `${name} ${kind}`, 'number']);
      series.push(values);
    }
  };
  for (const [name, output] of Object.entries(data.outputs)) {
    add(`${name} measured`, output.measured);
    add(`${name} model`, output.simulated);
    add(`${name} residual`, output.residual);
    const before = previous?.outputs[name] && aligned(data.time, previous, previous.outputs[name].simulated);
    if (before) add(`${name} the other fit`, before);
  }
  for (const [name, input] of Object.entries(data.inputs)) add(name, input);
  return {
    columns,
    rows: data.time.flatMap((time, at) =>
      seconds(time) < from || seconds(time) > to ? [] : [[time, ...series.map(values => (values[at] === null ? NONE : number(values[at], 5)))]],
    ),
  };
}

function summaryOf(data) {
  const parts = Object.entries(data.errors).map(
    ([name, error]) =>
      `${name}: the model errs by ${number(error.range.rmse)} ${error.unit} over ${error.range.n} samples, bias ${number(error.range.bias)}; ${Object.entries(
        error.parts,
      )
        .map(([part, skill]) => `${part} ${number(skill.rmse)}`)
        .join(', ')}.`,
  );
  return `${data.mode === 'free_run' ? 'Free run' : `Forecasts ${horizon(data.horizon)} ahead`} from ${data.from} to ${data.to}. ${parts.join(' ')}`;
}

export function FitTab({ system, fit, fits, metrics, params, document, query: asked }) {
  const ahead = forecasts(metrics);
  // A link from a system that forecasts leads to what there is here.
  const query = ahead ? asked : { ...asked, mode: undefined };
  // Beside what is served stands what was served before, unless another fit is asked for, or none.
  const history = useList(fit && fit === params?.fit ? `/params/${system}/history` : null);
  const before =
    history.data?.find(revision => !revision.current && revision.fit !== fit && fits.some(entry => entry.id === revision.fit))?.fit ?? null;
  const beside = query.with === NO_OTHER ? null : (query.with ?? before);
  const choice = useRef(null);
  useKeys({ c: ['choose a fit to compare with', () => choice.current?.focus()] });
  const path = fit && withQuery(`/fits/${fit}/comparison`, viewOf(query));
  const whole = useResource(path);
  if (!fit)
    return html`<${Empty} title="Never fitted">
      <p>Upload measurements, then press Refit: it takes some seconds.</p>
      <a class="button" href=${systemAddress(system, 'data')}>Upload measurements</a>
    </${Empty}>`;
  return html`
    <div class="row apart">
      ${
        ahead &&
        html`<span class="segments" role="group" aria-label="What the model knows">${VIEWS.map(
          ([value, title]) => html`
        <button aria-pressed=${(query.mode ?? 'free_run') === value}
          onClick=${() => setQuery({ mode: value === 'free_run' ? null : value })}>${title}</button>`,
        )}</span>`
      }
      <${Outputs} metrics=${metrics} query=${query} all />
      ${fits.some(entry => entry.id !== fit) &&
        html`<label class="inline">Beside it <select ref=${choice} value=${beside ?? NO_OTHER} onChange=${event => setQuery({ with: event.target.value })}>
        <option value=${NO_OTHER}>no other fit</option>
        ${fits.filter(entry => entry.id !== fit).map(entry =>
          html`<option value=${entry.id} selected=${entry.id === beside}>${fitName(entry)}</option>`)}</select></label>`}
    </div>
    ${(Object.keys(metrics).length > 1 || !ahead) &&
      html`<${Flowsheet} model=${fits.find(entry => entry.id === fit)?.model ?? document.model} metrics=${metrics} query=${query} />`}
    <p class="note">${
      query.mode && query.mode !== 'free_run'
        ? `At each time the forecast that was made ${horizon(query.mode)} before, from the states that the model then had.`
        : html`<${Term} of="free run">One simulation from the start</${Term}>: the model never sees the measured output again.`
    }${ahead ? '' : ` ${NO_FORECASTS}`}</p>
    <${Shown} of=${whole} what="the comparison"
      show=${data => html`<${Chart} whole=${data} fit=${fit} fits=${fits} beside=${beside} metrics=${metrics} query=${query} zone=${document.location?.zone ?? 'UTC'} />`} />`;
}

function Chart({ whole, fit, fits, beside, metrics, query, zone }) {
  const ends = useMemo(() => [seconds(whole.from), seconds(whole.to)], [whole]);
  const range = query.from && query.to ? [seconds(query.from), seconds(query.to)] : null;
  // A thinned line is asked for anew where it is looked at closely, with as much again on both sides for moving on.
  const margin = range ? range[1] - range[0] : 0;
  const closer =
    range && whole.thinning
      ? { from: instant(Math.max(range[0] - margin, ends[0])), to: instant(Math.min(range[1] + margin, ends[1])) }
      : {};
  const comparison = further => withQuery(`/fits/${fit}/comparison`, { ...viewOf(query), ...further });
  const detail = useResource(closer.from ? comparison(closer) : null);
  const data = detail.data?.fit === fit ? detail.data : whole;
  const other = useResource(beside ? withQuery(`/fits/${beside}/comparison`, { ...viewOf(query), from: data.from, to: data.to }) : null);
  const another = beside && other.data?.fit === beside ? other.data : null;
  const time = useMemo(() => data.time.map(seconds), [data]);
  const chosen = outputIn(query, metrics, true);
  const shown = range ? [Math.max(range[0], ends[0]), Math.min(range[1], ends[1])] : ends;
  const mode = query.mode ?? 'free_run';
  // One answer has every error of the table: of the samples that are shown, and where two fits are compared, that both have.
  const span = { from: instant(shown[0]), to: instant(shown[1]), max_points: 1 };
  const path = comparison(range ? { from: span.from, to: span.to } : {});
  const isThinned = (shown[1] - shown[0]) / data.step_s + 1 > POINTS;
  const several = beside && withQuery('/compare', { fits: `${fit},${beside}`, ...runOf(query), ...span });
  const closely = range && !REPORT ? withQuery(`/fits/${fit}/comparison`, { ...runOf(query), ...span }) : null;
  const errors = useResource(several || closely);
  const judged = several || closely ? errors.data : whole;
  const strips = useMemo(() => stripsOf(data, another, chosen), [data, another, chosen]);
  const still = constants(data);
  const apart = another && !strips[0].lines.some(line => line.colour === 'previous');
  const parts = useMemo(() => whole.parts.map(part => ({ part: part.part, from: seconds(part.from), to: seconds(part.to) })), [whole]);
  const zoom = chosen => setQuery({ from: chosen && instant(chosen[0]), to: chosen && instant(chosen[1]) });
  const thinned = data.thinning
    ? `Thinned: one point of the chart stands for ${data.thinning.samples_per_point} of ${data.samples} samples and shows their lowest and highest value. Zoom in to see each.`
    : `Every one of the ${data.samples} samples is shown, ${length(data.step_s)} apart.`;
  return html`
    <${Frame} title=${chosen && Object.keys(metrics).length > 1 ? `Measured and model, ${chosen}` : 'Measured and model'}
      summary=${summaryOf(data)} about=${errorsInWords(judged ?? whole, mode, chosen, zone)}
      table=${() => tableOf(data, another, shown)} path=${path} csv
      everything=${isThinned && !REPORT ? () => everySample(fit, query, shown, data.step_s) : null}
      note=${`${thinned} Gaps are hatched. ${sentence(data.provenance.comment)}.${apart ?
        ' The other fit has other times and is not drawn.' : ''}${still.length ? ` Never changing, and not drawn: ${still.join(', ')}.` : ''}${other.error ? ` The other fit: ${other.error.detail}.` : ''}`}>
      <${Strips} time=${time} strips=${strips} whole=${ends} range=${range} parts=${parts} zone=${zone} onZoom=${zoom} label=${summaryOf(data)} />
    </${Frame}>
    <${Errors} of=${errors} judged=${judged} chosen=${chosen} mode=${mode} zone=${zone}
      fits=${[fit, beside].filter(Boolean).map(id => fits.find(entry => entry.id === id) ?? { id })} />`;
}
