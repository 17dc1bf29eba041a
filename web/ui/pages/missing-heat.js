// What flows into a room that its model does not know of, hour by hour, beside every channel that was measured.
import { html, useMemo } from '../html.js';
import { useResource, withQuery } from '../api.js';
import { REPORT } from '../carried.js';
import { setQuery } from '../router.js';
import { number, signed, percent, clock, instant, seconds, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Term } from '../parts/term.js';
import { Failed, Loading } from '../parts/screens.js';
import { Curve } from '../charts/curve.js';
import { Strips } from '../charts/strips.js';

const HOUR = 3600;
/** So many events are listed, the largest first. */
const LISTED = 12;
/** Points of a channel that is drawn beside. */
const POINTS = 4000;
/** The answer to a model for which there is none. */
const UNPROCESSABLE = 422;
const DAYS = ['Mon', 'Tue', 'Wed', 'Thu', 'Fri', 'Sat', 'Sun'];

/** `path` is that of a diagnosis or of a fit. */
export function MissingHeat({ path: of, output, system, query, zone }) {
  const path = withQuery(`${of}/missing-heat`, { output });
  const heat = useResource(path);
  if (heat.error?.status === UNPROCESSABLE)
    return html`<p class="note">What flows unseen cannot be told here: ${heat.error.errors?.[0]?.detail ?? heat.error.detail}.</p>`;
  if (heat.error) return REPORT ? null : html`<${Failed} error=${heat.error} retry=${heat.reload} />`;
  if (heat.data === null) return html`<${Loading} what="what flows unseen" />`;
  return html`<${Heat} heat=${heat.data} path=${path} system=${system} query=${query} zone=${zone} />`;
}

function Heat({ heat, path, system, query, zone }) {
  const about = `${heat.output}, ${clock(heat.hours[0]?.from, zone)} to ${clock(heat.hours.at(-1)?.from, zone)}`;
  const isHeat = heat.unit === 'K/h';
  return html`<section class="card" aria-labelledby="missing-heat"><h3 id="missing-heat">${
    isHeat ? html`<${Term} of="missing heat">Heat</${Term}> that the model does not know of` : `What flows into ${heat.state} that the model does not know of`}</h3>
    <ul>${heat.sentences.map(says => html`<li>${says.replaceAll(/\d{4}-\d\d-\d\dT[\d:]+Z/g, at => clock(at, zone))}</li>`)}</ul>
    <${OverTime} heat=${heat} path=${path} system=${system} query=${query} zone=${zone} about=${about} />
    <div class="grid">
      <${Events} heat=${heat} zone=${zone} />
      <${Week} heat=${heat} path=${path} about=${about} />
    </div>
    <p class="note">This is what ${heat.model} lacks with its parameters: what the fit has taken up into them is not missing here, so that
      times are surer than sizes. ${
        heat.per_kilowatt
          ? `A kilowatt makes ${number(heat.per_kilowatt)} ${heat.unit}, by ${heat.per_kilowatt_of}.`
          : 'No parameter of the model tells how much a kilowatt makes.'
      } Its bands stand for noise, not for a model that is wrong elsewhere.</p>
  </section>`;
}

/** A channel by these hours: the mean of its points in each. */
function byHour(channel, places, count) {
  const sums = Array.from({ length: count }, () => [0, 0]);
  const values = channel.values ?? channel.mean;
  channel.time.forEach((time, at) => {
    const place = places.get(Math.floor(seconds(time) / HOUR) * HOUR);
    if (place === undefined || values[at] === null) return;
    sums[place][0] += values[at];
    sums[place][1] += 1;
  });
  return sums.map(([sum, n]) => (n > 0 ? sum / n : null));
}

function OverTime({ heat, path, system, query, zone, about }) {
  const time = useMemo(() => heat.hours.map(hour => seconds(hour.from)), [heat]);
  const whole = [time[0], time.at(-1) + HOUR];
  const series = useResource(
    REPORT ? null : withQuery(`/systems/${system}/series`, { from: instant(whole[0]), to: instant(whole[1]), max_points: POINTS }),
  );
  const strips = useMemo(() => {
    const band = (name, end) => heat.hours.map(hour => hour[name]?.[end] ?? null);
    const missing = {
      label: 'missing',
      unit: heat.unit,
      height: 190,
      zero: true,
      lines: [
        { label: '95 %', colour: 'previous', min: band('band_95', 0), max: band('band_95', 1) },
        { label: '50 %', colour: 'model', min: band('band_50', 0), max: band('band_50', 1) },
        { label: 'likeliest', colour: 'heldout', width: 1.8, values: heat.hours.map(hour => hour.rate) },
      ],
    };
    const places = new Map(time.map((at, place) => [at, place]));
    const channels = Object.entries(series.data?.channels ?? {}).map(([name, channel]) => ({
      label: name,
      unit: channel.unit,
      height: 56,
      lines: [{ label: name, colour: 'measured', width: 1.2, values: byHour(channel, places, time.length) }],
    }));
    return [missing, ...channels];
  }, [heat, series.data, time]);
  const range = query.from && query.to ? [seconds(query.from), seconds(query.to)] : null;
  const known = heat.hours.filter(hour => hour.rate !== null);
  const says = `Means of ${known.length} hours; usually ${signed(heat.usual)} ${heat.unit}. A sensor errs by ${number(heat.sensor_sd)}, what is missing remembers for ${number(heat.memory_hours)} h.`;
  return html`<${Frame} title="Missing, hour by hour" about=${about} path=${path} csv summary=${says} note=${says}
    table=${() => ({
      columns: [['hour'], [heat.unit, 'number'], ['50 % from', 'number'], ['to', 'number'], ['95 % from', 'number'], ['to', 'number']],
      rows: known.map(hour => [clock(hour.from, zone), ...[hour.rate, ...hour.band_50, ...hour.band_95].map(value => number(value, 4))]),
    })}>
    ${series.error && html`<${Failed} error=${series.error} retry=${series.reload} />`}
    <${Strips} time=${time} strips=${strips} whole=${whole} range=${range} zone=${zone} label=${`Missing heat and the channels. ${says}`}
      onZoom=${chosen => setQuery({ from: chosen && instant(chosen[0]), to: chosen && instant(chosen[1]) })} />
  </${Frame}>`;
}

function Events({ heat, zone }) {
  if (heat.events.length === 0) return null;
  const largest = heat.events.toSorted((a, b) => Math.abs(b.sum) - Math.abs(a.sum)).slice(0, LISTED);
  const state = heat.unit.replace('/h', '');
  const kilowatts = rate => (heat.per_kilowatt ? signed(rate / heat.per_kilowatt) : NONE);
  const show = event => setQuery({ from: instant(seconds(event.from) - 12 * HOUR), to: instant(seconds(event.from) + (event.hours + 12) * HOUR) });
  return html`<section>
    ${heat.habits.length > 0 && html`<${Table} caption="Events that are alike" columns=${[['hours'], ['events', 'number'], ['rate', 'number'],
      ['lasts', 'number'], ['every', 'number'], ['on working days', 'number']]}
      rows=${heat.habits.map(habit => [`${habit.begins} to ${habit.ends} h`, habit.events, `${signed(habit.rate)} ${heat.unit}`, `${habit.hours} h`,
        `${number(habit.every_days)} d`, percent(habit.on_working_days)])} />`}
    <${Table} caption=${heat.events.length > LISTED ? `The ${LISTED} largest of ${heat.events.length} events` : 'Events, the largest first'}
      columns=${[['from'], ['lasts', 'number'], ['rate', 'number'], ['kW', 'number'], [`sum, ${state}`, 'number'], ['']]}
      rows=${largest.map(event => [html`<span class="nowrap">${clock(event.from, zone)}</span>`, `${event.hours} h`, `${signed(event.rate)} ${heat.unit}`,
        kilowatts(event.rate), signed(event.sum),
        html`<button class="plain" aria-label=${`Show ${clock(event.from, zone)} above`} onClick=${() => show(event)}>Show</button>`])} />
  </section>`;
}

function Week({ heat, path, about }) {
  const points = heat.week.map((hour, at) => [at, hour.rate]).filter(([, rate]) => rate !== null);
  if (points.length === 0) return null;
  const [at, rate] = points.reduce((most, point) => (Math.abs(point[1] - heat.usual) > Math.abs(most[1] - heat.usual) ? point : most));
  const says = `The mean week: farthest from what is usual at ${DAYS[Math.floor(at / 24)]} ${at % 24} h, ${signed(rate)} ${heat.unit}.`;
  return html`<${Frame} title="Missing in a mean week" about=${about} path=${path} summary=${says} note=${says}
    table=${() => ({
      columns: [['day'], ['hour', 'number'], [heat.unit, 'number'], ['hours', 'number']],
      rows: heat.week.map(hour => [DAYS[hour.weekday], hour.hour, hour.rate === null ? NONE : number(hour.rate), hour.hours]),
    })}>
    <${Curve} height=${220} zero across=${[0, 7 * 24]} at=${DAYS.map((_, day) => 24 * day)} xLabel="hour of the week, from Monday on" yLabel=${heat.unit}
      lines=${[{ colour: 'model', open: true, points }]} label=${says} />
  </${Frame}>`;
}
