// When and where the model fails, from one document of diagnostics.
import { html } from '../html.js';
import { useResource, withQuery } from '../api.js';
import { systemAddress, go } from '../router.js';
import { number, fixed, signed, percent, horizon, clock, instant, seconds, NONE } from '../format.js';
import { midnight } from '../zones.js';
import { Frame } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Shown, Empty } from '../parts/screens.js';
import { Outputs, outputIn, forecasts, NO_FORECASTS } from '../parts/outputs.js';
import { Heatmap } from '../charts/heatmap.js';
import { ByLag, Innovations } from './residuals.js';

const HOUR = 3600;
/** So many circumstances are shown at once. */
const CIRCUMSTANCES = 14;
/** From here on a circumstance has clearly more of the error than of the time, and here its bar ends. */
const MUCH_LIFT = 1.25;
const MOST_LIFT = 4;

export function Fails({ system, fit, metrics, query, document }) {
  const several = Object.keys(metrics).length > 1;
  const output = several ? outputIn(query, metrics) : null;
  const path = fit && withQuery(`/fits/${fit}/diagnostics`, { output });
  const diagnostics = useResource(path);
  if (!fit) return html`<${Empty} title="Never fitted"><p>What fails can be said of a fit. Press Refit.</p></${Empty}>`;
  const zoom = (from, to) => go(systemAddress(system, 'fit', { fit: query.fit, with: query.with, output: query.output, from: instant(from), to: instant(to) }));
  return html`
    ${several && html`<p><${Outputs} metrics=${metrics} query=${query} /></p>`}
    <${Shown} of=${diagnostics} what="the diagnostics" show=${data => html`
      <${Failures} data=${data} ahead=${forecasts(metrics)} path=${path} zoom=${zoom} zone=${document.location?.zone ?? 'UTC'} />`} />`;
}

/** Of which output, days and error a picture is. */
function aboutOf(data, output, zone) {
  const { unit, ...parts } = data.skill[output];
  const days = data.hour_by_date;
  const errors = Object.entries(parts).filter(([, skill]) => skill).map(([part, skill]) => `${part} ${fixed(skill.rmse)} ${unit}`);
  return `${output}, ${days[0]?.date} to ${days.at(-1)?.date} (${zone}), free run, rmse ${errors.join(', ')}`;
}

/** The sentences of a summary, instants as people read them. */
const sentencesOf = (text, zone) =>
  text
    .split(/\.\s+/)
    .map(sentence => sentence.replace(/\.$/, '').replaceAll(/\d{4}-\d\d-\d\dT[\d:]+Z/g, at => clock(at, zone)))
    .filter(Boolean);

function Failures({ data, ahead, path, zoom, zone }) {
  const { output } = data;
  const { unit } = data.skill[output];
  const about = aboutOf(data, output, zone);
  const around = episode => zoom(seconds(episode.from) - 12 * HOUR, seconds(episode.to) + 12 * HOUR);
  const cells = data.hour_by_date
    .flatMap(day => day.hours.map((value, hour) => [day.date, hour, value]))
    .filter(([, , value]) => value !== null);
  const worst = cells.reduce((found, cell) => (Math.abs(cell[2]) > Math.abs(found[2]) ? cell : found), ['', 0, 0]);
  return html`
    <section class="card" aria-label="In words"><ul>${sentencesOf(data.summary, zone).map(sentence => html`<li>${sentence}.</li>`)}</ul></section>
    <${Frame} title=${`Error by day and hour, ${output}`} about=${about}
      path=${path}
      note=${zone === 'UTC' ? 'Hours are UTC: the system names no time zone.' : `Hours are of ${zone}.`}
      summary=${`The worst hour is ${worst[1]} h on ${worst[0]}: ${signed(worst[2])} ${unit}.`}
      table=${() => ({ columns: [['day'], ['hour', 'number'], [`measured − model, ${unit}`, 'number']], rows: cells.map(([date, hour,
        value]) => [date, hour, number(value, 4)]) })}>
      <${Heatmap} days=${data.hour_by_date} unit=${unit} onPick=${date => zoom(midnight(date, zone), midnight(date, zone) + 24 * HOUR)}
        label=${`Mean error of ${output} by hour and day; the worst is ${signed(worst[2])} ${unit} at ${worst[1]} h on ${worst[0]}.`} />
    </${Frame}>
    <div class="grid">
      <section><${Regimes} rows=${data.by_regime} unit=${unit} /></section>
      <section>
        <${Table} caption="Worst six hours"
          columns=${[['when'], ['bias', 'number'], ['rmse', 'number'], ['of the error', 'number'], ['unusual then'], ['']]}
          rows=${data.episodes.map(episode => [
            html`<span class="nowrap">${clock(episode.from, zone)}</span>`,
            `${signed(episode.bias)} ${unit}`,
            `${fixed(episode.rmse)} ${unit}`,
            percent(episode.share),
            contextOf(episode.context),
            html`<button class="plain" aria-label=${`Show ${clock(episode.from, zone)} in the chart`} onClick=${() => around(episode)}>Show</button>`,
          ])} />
        <p class="note">Unusual: how many standard deviations a channel is from its mean.</p>
        <${Table} caption=${ahead ? 'How far ahead' : 'Free run of each output'}
          columns=${[[ahead ? 'forecast' : 'output'], ['rmse', 'number'], ['holding the last value', 'number'], ['bias', 'number'], ['r²', 'number']]}
          rows=${Object.entries(data.by_horizon).flatMap(([name, rows]) => rows.map(row =>
            [`${name}, ${horizon(row.horizon)}`, `${fixed(row.rmse)} ${data.skill[name].unit}`,
              `${fixed(row.persistence_rmse)} ${data.skill[name].unit}`, `${signed(row.bias)} ${data.skill[name].unit}`, number(row.r2)]))} />
        <p class="note">Judged on the ${data.judged_on} part.${ahead ? '' : ` ${NO_FORECASTS}`}</p>
      </section>
    </div>
    <${ByLag} inputs=${data.residual_by_input} output=${output} about=${about} path=${path} />
    <${Innovations} data=${data.innovations} output=${output} about=${about} path=${path} rho=${data.rho[output]} floor=${data.noise_floor[output]} unit=${unit} />`;
}

const contextOf = context =>
  Object.entries(context)
    .map(([name, value]) => `${name === 'hour_of_day' ? 'hour of the day' : name} ${signed(value, 1)}`)
    .join(', ') || NONE;

/** How much more of the squared error than of the time: where a model fails, not where it merely spends its time. */
const liftOf = row => (row.time_share > 0 ? row.error_share / row.time_share : 0);

/** Regimes, the largest lift first. */
function Regimes({ rows, unit }) {
  const sorted = rows.toSorted((a, b) => liftOf(b) - liftOf(a));
  const part = (shown, hidden) => html`<${Table} caption="By circumstances, where the model fails most first" hidden=${hidden}
    columns=${[['when'], ['lift', 'number'], ['of the time', 'number'], ['of the error', 'number'], ['bias', 'number'],
      ['rmse', 'number'], ['']]}
      rows=${shown.map(row => [
        row.regime,
        html`<b title=${`${percent(row.error_share)} of the squared error in ${percent(row.time_share)} of the time`}>${liftOf(row).toFixed(1)}</b>`,
        percent(row.time_share),
        percent(row.error_share),
        html`<span title=${row.bias_ci95 ? `95 %: ${signed(row.bias_ci95[0])} to ${signed(row.bias_ci95[1])}` : ''}>
          ${signed(row.bias)} ${unit}</span>`,
        `${fixed(row.rmse)} ${unit}`,
        html`<span class="bar" aria-hidden="true"
          style=${{ width: `${Math.round(Math.min(liftOf(row), MOST_LIFT) * 60 / MOST_LIFT)}px`, background: liftOf(row) > MUCH_LIFT ?
            'var(--heldout)' : 'var(--model)' }}></span>`,
      ])} />`;
  const rest = sorted.slice(CIRCUMSTANCES);
  return html`${part(sorted.slice(0, CIRCUMSTANCES), false)}
    ${rest.length > 0 && html`<details><summary>${rest.length} more, with a lift of at most ${liftOf(rest[0]).toFixed(1)}</summary>${part(rest, true)}</details>`}
    <p class="note">Lift: the share of the squared error over that of the time; 1 is as everywhere else. Orange bars lie above ${MUCH_LIFT}. Bias is measured − model. Circumstances overlap.</p>`;
}
