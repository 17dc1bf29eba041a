// A file of measurements, and how it is read: shown on its first rows before anything is kept. Only what the file
// leaves open is asked.
import { html, useState, useRef, useEffect } from '../html.js';
import { ask, withQuery } from '../api.js';
import { clock, number, percent } from '../format.js';
import { zoneNames } from '../zones.js';
import { Failed, Loading } from './screens.js';
import { Table } from './table.js';

const KNOWN = [
  'T_room',
  'T_out',
  'T_forward',
  'irradiance',
  'cloud_cover',
  'wind_speed',
  'wind_direction',
  'flow',
  'valve',
  'window_open',
  'occupancy',
  'CO2',
];
const UNITS = ['-', 'degC', 'degF', 'K', 'W', 'kW', 'MW', 'W/m2', 'kW/m2', 'm/s', 'km/h', 'ppm', 'pct', 'deg', 'm3/h', 'm3/d', 'g/m3'];
const DATES = {
  year_first: 'the year before month and day',
  day_first: 'the day before the month',
  month_first: 'the month before the day',
  unix_seconds: 'seconds since 1970',
  unix_milliseconds: 'milliseconds since 1970',
};
/** What a file may leave open, by the fault that says so: the question, and its answers. */
const QUESTIONS = {
  'ambiguous-dates': {
    field: 'dates',
    asks: 'Which comes first in its dates?',
    answers: { day_first: DATES.day_first, month_first: DATES.month_first },
  },
  'ambiguous-decimals': {
    field: 'decimal',
    asks: 'What follows the commas in its numbers?',
    answers: { comma: 'decimals: 1,250 is one and a quarter', point: 'thousands: 1,250 is one thousand two hundred and fifty' },
  },
};
const SEPARATORS = { ',': 'commas', ';': 'semicolons', '\t': 'tabs', '|': 'bars' };

/** A column as it was confirmed for an earlier file, or as it is proposed. */
function understood(column, bindings) {
  const [channel, said] = Object.entries(bindings).find(([, bound]) => bound === column.column || bound.startsWith(`${column.column}[`)) ?? [];
  // A file is refused where a cell of a column that is used is no number.
  if (!channel) return { ...column, use: column.channel !== null && column.odd === 0, channel: column.channel ?? nameOf(column) };
  const unit = column.stated || said === column.column ? column.unit : said.slice(column.column.length + 1, -1);
  return { ...column, use: true, channel, unit };
}

/**
 * A file on its way: `{body, data, error, zone, dates, decimal, columns, take, leave, say, change}`. `known` is the zone that goes
 * without asking; otherwise that of this browser is proposed where the file needs one. `bindings` are the columns that were
 * confirmed before.
 */
export function useReading(known = null, bindings = {}) {
  const [body, setBody] = useState(null);
  const [said, setSaid] = useState({ zone: known, dates: null, decimal: null });
  const [state, setState] = useState({ data: null, error: null });
  const [columns, setColumns] = useState([]);
  useEffect(() => {
    if (body === null) return undefined;
    const abort = new AbortController();
    ask(withQuery('/windows/recognise', said), { method: 'POST', csv: body, signal: abort.signal }).then(
      data => {
        if (data.asks.includes('zone')) setSaid(before => ({ ...before, zone: Intl.DateTimeFormat().resolvedOptions().timeZone }));
        else {
          setState({ data, error: null });
          setColumns(data.columns.map(column => understood(column, bindings)));
        }
      },
      error => error.name !== 'AbortError' && setState({ data: null, error }),
    );
    return () => abort.abort();
  }, [body, said]);
  return {
    body,
    columns,
    ...state,
    ...said,
    isKnown: said.zone === known,
    take: content => {
      setState({ data: null, error: null });
      setSaid({ zone: known, dates: null, decimal: null });
      setBody(content);
    },
    leave: () => {
      setState({ data: null, error: null });
      setBody(null);
    },
    say: what => setSaid({ ...said, ...what }),
    change: (at, what) => setColumns(columns.map((column, index) => (index === at ? { ...column, ...what } : column))),
  };
}

const nameOf = ({ column }) => column.replace(/\s*[[(][^\])]*[\])]$/, '');

/** The column as a binding names it: with the unit where its header does not say that. */
const bound = ({ column, unit, stated }) => (stated || unit === '-' ? column : `${column}[${unit}]`);

/** Channels with their columns, of those that are used. */
export const bindingsOf = columns => Object.fromEntries(columns.filter(({ use }) => use).map(column => [column.channel, bound(column)]));

/** Whether the service reads the file by its own names, so that nothing is to be bound. */
export const isPlain = columns =>
  columns.every(column => column.use && nameOf(column) === column.channel && (column.stated || column.unit === '-'));

/** The query by which the file is sent as it was read. */
export const saidOf = ({ data, zone, dates, decimal }, columns) => ({ zone: data.dialect.local ? zone : null, dates, decimal, columns });

/** Where a file is dropped, chosen or pasted. */
export function Drop({ take }) {
  const [over, setOver] = useState(false);
  const file = useRef(null);
  const drop = event => {
    event.preventDefault();
    setOver(false);
    take(event.dataTransfer.files[0] ?? event.dataTransfer.getData('text/plain'));
  };
  return html`<div class="drop ${over ? 'over' : ''}" onDrop=${drop} onDragOver=${event => {
    event.preventDefault();
    setOver(true);
  }} onDragLeave=${() => setOver(false)}>
    <p>Drop a CSV file here, or <button type="button" onClick=${() => file.current.click()}>choose one</button></p>
    <p class="quiet">As it is: separators, decimal commas, dates and units are recognised, and shown before anything is kept.</p>
    <input ref=${file} class="unseen" type="file" accept=".csv,.txt,.tsv,text/csv" aria-label="CSV file" tabindex="-1"
      onChange=${event => event.target.files[0] && take(event.target.files[0])} />
    <label>or paste its text<textarea rows="3" placeholder="time,T_room[degC],T_out[degC]" onPaste=${event => {
      event.preventDefault();
      take(event.clipboardData.getData('text/plain'));
    }} onChange=${event => event.target.value.trim() && take(event.target.value)}></textarea></label>
  </div>`;
}

/** How the file is read, and what it leaves open. */
export function HowRead({ of: reading }) {
  const { body, data, error, zone, say, isKnown } = reading;
  if (body === null) return null;
  const fault = error?.errors?.[0];
  // What was answered stays in sight, to be answered otherwise.
  const asked = Object.entries(QUESTIONS).filter(([code, { field }]) => code === fault?.code || reading[field]);
  const questions = asked.map(([, { field, asks, answers }]) => html`<fieldset><legend>${asks}</legend><span class="row">${Object.entries(answers).map(
    ([answer, words]) => html`<button type="button" aria-pressed=${reading[field] === answer} onClick=${() => say({ [field]: answer })}>${words}</button>`,
  )}</span></fieldset>`);
  if (fault?.code in QUESTIONS) return html`<p>▲ ${fault.detail}</p>${questions}`;
  if (error) return html`<${Failed} error=${error} />`;
  if (!data) return html`<${Loading} what="what the file says" />`;
  const { dialect, rows, from, to, rejected } = data;
  const ways = [
    `${dialect.encoding}, ${SEPARATORS[dialect.separator] ?? dialect.separator} between its cells`,
    dialect.decimal === 'comma' && 'decimal commas',
    DATES[dialect.dates] && `in its times ${DATES[dialect.dates]}`,
  ].filter(Boolean);
  return html`<p>${number(rows)} rows from ${clock(from, zone ?? 'UTC')} to ${clock(to, zone ?? 'UTC')}. Read as ${ways.join(', ')}.</p>
    ${dialect.local &&
      html`<label class="inline">Its times have no offset: they are of <select value=${zone}
        onChange=${event => say({ zone: event.target.value })}>${[...new Set([zone, ...zoneNames()])].filter(Boolean).map(name => html`<option value=${name} selected=${name === zone}>${name}</option>`)}</select>
        ${isKnown ? 'as the system says' : 'as this browser says: is that right?'}</label>`}
    ${questions}
    ${rejected.length > 0 && html`<${Rejected} reasons=${rejected} word="would be" />`}`;
}

/** Rows that are left out, one line for each reason. */
export const Rejected = ({ reasons, word = 'were' }) => html`<ul>${reasons.map(
  ({ reason, count, line }) => html`<li>▲ ${count} ${count === 1 ? 'row' : 'rows'} ${count === 1 && word === 'were' ? 'was' : word} left out, the first in line ${line}: ${reason}</li>`,
)}</ul>`;

/** What the columns are, with their first values. `room` shows which room each is in. */
export function Columns({ of: { columns, change }, channels = [], rooms = null }) {
  const names = [...new Set([...channels, ...KNOWN])];
  return html`<datalist id="channels">${names.map(name => html`<option value=${name} />`)}</datalist>
    <${Table} caption="Columns of the file, as they are understood" columns=${[
      ['column'],
      ['use'],
      ['channel'],
      ['unit'],
      ...(rooms ? [['room']] : []),
      ['complete', 'number'],
      ['range'],
      ['first values'],
    ]} rows=${columns.map((column, at) => [
      column.column,
      html`<input type="checkbox" aria-label=${`Use ${column.column}`} checked=${column.use} onChange=${event => change(at, { use: event.target.checked })} />`,
      html`<input list="channels" aria-label=${`Channel of ${column.column}`} value=${column.channel} onInput=${event => change(at, { channel: event.target.value, use: true })} />`,
      column.stated
        ? html`<span title="as its header says">${column.unit}</span>`
        : html`<select aria-label=${`Unit of ${column.column}`} value=${column.unit} onChange=${event => change(at, { unit: event.target.value })}>
          ${[...new Set([...UNITS, column.unit])].map(unit =>
            html`<option value=${unit} selected=${unit === column.unit}>${unit === '-' ? 'none' : unit}</option>`)}</select>`,
      ...(rooms
        ? [html`<select aria-label=${`Room of ${column.column}`} value=${column.room ?? ''} onChange=${event => change(at, { room: event.target.value || null })}>
          <option value="" selected=${column.room === null}>all of them</option>${rooms.map(({ id, label }) =>
            html`<option value=${id} selected=${id === column.room}>${label}</option>`)}</select>`]
        : []),
      percent(column.complete),
      html`<span class="nowrap">${column.min === null ? 'no values' : `${number(column.min)} to ${number(column.max)}`}</span>${
        column.odd > 0 ? html` <small>▲ ${column.odd} of its cells ${column.odd === 1 ? 'is no number' : 'are no numbers'}</small>` : ''
      }`,
      column.first.map(value => (value === null ? 'none' : number(value))).join(', '),
    ])} />`;
}
