// Which rooms are next door, proposed from how alike their temperatures move; what is right is taken over.
import { html, useState } from '../html.js';
import { ask, every, putSystem, useResource, curl } from '../api.js';
import { useSystems } from '../systems.js';
import { setQuery, systemAddress } from '../router.js';
import { say, sayFault } from '../say.js';
import { clock, instant, length, reading, seconds } from '../format.js';
import { save, Frame } from '../parts/frame.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Empty, NotSaved, Shown } from '../parts/screens.js';

/** The newest five weeks; the thesis takes two, and days that differ help. */
const SPAN_S = 35 * 86_400;
/** Five weeks at five minutes: more is thinned to means. */
const MOST_POINTS = 10_080;
const SHOWN = 20;
const CHANNEL = 'T_room';
const FILE = 'temperatures.csv';
const shown = correlation => reading(correlation, 2);
const columnOf = system => `T_${system.replace('/', '_')}`;

/** The temperatures of a system, `{system, column, time, values}`; or why it has none here, `{system, why}`. */
async function temperatures(system, range, signal) {
  try {
    const query = new URLSearchParams({ ...range, channels: CHANNEL, max_points: MOST_POINTS });
    const { [CHANNEL]: channel } = (await ask(`/systems/${system}/series?${query}`, { signal })).channels;
    if (!channel) return { system, why: `it has no ${CHANNEL} in this time` };
    const values = channel.values ?? channel.mean;
    return { system, column: columnOf(system), time: channel.time, values };
  } catch (error) {
    if (error.status !== 404 && error.status !== 422) throw error;
    return { system, why: error.errors?.[0]?.detail ?? error.detail };
  }
}

/** The temperatures side by side, a row for each time that any of them has. */
function csvOf(rooms) {
  const rows = new Map();
  rooms.forEach(({ time, values }, at) =>
    time.forEach((instant_, index) => {
      if (!rows.has(instant_)) rows.set(instant_, rooms.map(() => ''));
      rows.get(instant_)[at] = values[index] ?? '';
    }),
  );
  const lines = [...rows].sort(([one], [other]) => seconds(one) - seconds(other)).map(([time, cells]) => [time, ...cells].join());
  return [['time', ...rooms.map(({ column }) => `${column}[degC]`)].join(), ...lines].join('\n');
}

/** What the service proposes for the rooms that were measured beside one, and what it was asked with; false without measurements. */
async function propose(path, { signal }) {
  const beside = path.replace('/systems/', '');
  const { to } = await ask(`${path}/series?max_points=10`, { signal });
  if (to === null) return false;
  const range = { from: instant(seconds(to) - SPAN_S), to };
  const systems = (await every('/systems', { signal })).map(row => row.system);
  const asked = await Promise.all(systems.map(system => temperatures(system, range, signal)));
  const rooms = asked.filter(({ why }) => !why);
  const csv = csvOf(rooms);
  const layout = rooms.length > 1 ? await ask('/systems/layout', { method: 'POST', csv, signal }) : null;
  const documents = await Promise.all(rooms.map(({ system }) => ask(`/systems/${system}`, { signal })));
  return { beside, range, rooms, csv, layout, documents, without: asked.filter(({ why }) => why) };
}

export function Neighbours({ query }) {
  const systems = useSystems();
  const named = query.system ?? systems.rows?.find(row => row.system.startsWith('room/'))?.system ?? null;
  const proposal = useResource(named && `/systems/${named}`, { read: propose });
  const empty = html`<${Empty} title="No systems yet"><p>Rooms that are measured at the same time can be compared.</p></${Empty}>`;
  return html`
    <div class="row apart"><h1>Neighbours</h1>
      <label class="inline">Measured beside <select value=${named} onChange=${event => setQuery({ system: event.target.value })}>
        ${(systems.rows ?? []).map(({ system, label }) =>
          html`<option value=${system} selected=${system === named}>${system}${label ? `, ${label}` : ''}</option>`)}</select></label></div>
    <p>Rooms next door warm each other. Where nobody has the plan of the building, their temperatures propose who is next to whom.</p>
    <${Shown} of=${{ ...systems, data: systems.rows }} what="the systems" empty=${empty} show=${() => html`
      <${Shown} of=${proposal} what="the temperatures of all rooms" show=${data =>
        data ? html`<${Proposal} key=${data.beside} ...${data} />` : html`<${Empty} title="Nothing to compare"><p>${named} has no measurements
          yet. Choose a room that was measured beside others.</p></${Empty}>`} />`} />`;
}

function Proposal({ beside, range, rooms, csv, layout, documents: read, without }) {
  const [documents, setDocuments] = useState(Object.fromEntries(read.map(document => [document.system, document])));
  const [refused, setRefused] = useState(null);
  const taken = document => setDocuments(before => ({ ...before, [document.system]: document }));
  const add = async (system, neighbour) => {
    setRefused(null);
    const seen = documents[system];
    try {
      taken(await putSystem(seen, { ...seen, neighbours: [...seen.neighbours, neighbour] }));
      say(`${neighbour} is a neighbour of ${system}`);
    } catch (fault) {
      setRefused({ fault, system });
    }
  };
  const again = () =>
    ask(`/systems/${refused.system}`).then(document => {
      taken(document);
      setRefused(null);
    }, sayFault);
  const left =
    without.length > 0 &&
    html`<${Table} caption="Not compared" columns=${[['system'], ['why']]} rows=${without.map(({ system, why }) => [system, why])} />`;
  if (!layout)
    return html`<${Empty} title="Nothing to compare"><p>From ${clock(range.from)} to ${clock(range.to)} no two rooms have a temperature ${CHANNEL}. Choose a room that was measured beside
      others.</p></${Empty}>${left}`;
  const systemOf = Object.fromEntries(rooms.map(({ system, column }) => [column, system]));
  // Of several systems in one room the one that was asked about speaks for it.
  const named = Object.fromEntries(
    layout.rooms.map(room => [room.id, room.sensors.includes(columnOf(beside)) ? beside : systemOf[room.representative]]),
  );
  const ways = layout.neighbours.flatMap(pair => {
    const [one, other] = pair.rooms.map(id => named[id]);
    return [[one, other, pair], [other, one, pair]];
  });
  // Those of the room that was asked about come first.
  ways.sort(([one], [other]) => (other === beside) - (one === beside));
  const shared = layout.rooms.filter(room => room.sensors.length > 1);
  return html`
    <p>${layout.summary}</p>
    ${layout.warnings.map(warning => html`<p class="note">▲ ${warning}</p>`)}
    ${refused && html`<${NotSaved} error=${refused.fault} again=${again}><p>Somebody has changed ${refused.system} since this was read.
      Press the button again if it is still right.</p></${NotSaved}>`}
    ${ways.length > 0 && html`<${Table} caption="Rooms that look like neighbours"
      columns=${[['room'], ['beside'], ['in its settings'], ['correlation', 'number'], ['samples', 'number']]}
      rows=${ways.map(([system, neighbour, pair]) => [
        html`<a href=${systemAddress(system, 'settings')}>${system}</a>`,
        neighbour,
        documents[system].neighbours.includes(neighbour)
          ? html`<${Status} of="ok" label="yes" />`
          : html`<button aria-label=${`Add ${neighbour} to the neighbours of ${system}`} onClick=${() => add(system, neighbour)}>Add</button>`,
        shown(pair.correlation),
        pair.samples,
      ])} />`}
    ${shared.length > 0 && html`<${Table} caption="Sensors that look like one room" columns=${[['systems'], ['correlation', 'number']]}
      rows=${shared.map(room => [room.sensors.map(sensor => systemOf[sensor]).join(', '), shown(room.correlation)])} />`}
    <${Pairs} layout=${layout} systemOf=${systemOf} />
    <p class="row"><button onClick=${() => save(new Blob([csv], { type: 'text/csv' }), FILE)}>Save ${FILE}</button></p>
    ${left}`;
}

/** The numbers behind the proposal. */
function Pairs({ layout, systemOf }) {
  const { correlation, levels, daily, thresholds } = layout;
  const names = layout.sensors.map(({ channel }) => systemOf[channel]);
  const pairs = names.flatMap((one, row) =>
    names.slice(row + 1).map((other, at) => {
      const column = row + 1 + at;
      return [one, other, ...[correlation, levels, daily].map(matrix => matrix[row][column])];
    }),
  );
  pairs.sort(([, , one], [, , other]) => (other ?? -2) - (one ?? -2));
  const columns = [['room'], ['other'], ['counts', 'number'], ['temperatures', 'number'], ['within the day', 'number']];
  const rows = pairs.map(([one, other, ...values]) => [one, other, ...values.map(shown)]);
  const says = `${pairs.length} pairs of rooms, ${clock(layout.from)} to ${clock(layout.to)}, a sample each ${length(layout.step_s)}. From ${thresholds.same_room} on sensors look like one room, beyond ${thresholds.neighbour} rooms look like neighbours.`;
  return html`<${Frame} title="Correlation of each pair" drawn=${false} summary=${says} note=${`${says} ${layout.signal}${rows.length > SHOWN ? ` The first ${SHOWN} pairs are shown; the table has all.` : ''}`}
    command=${curl('/systems/layout', { file: FILE })} table=${() => ({ columns, rows })}>
    <${Table} caption="Correlation of each pair" hidden columns=${columns} rows=${rows.slice(0, SHOWN)} /></${Frame}>`;
}
