// New systems: from a file, whose rooms are proposed with their neighbours, or by a name and a model.
import { html, useState } from '../html.js';
import { ask, useList, post, put, withQuery } from '../api.js';
import { address, go, systemAddress } from '../router.js';
import { say, sayFault } from '../say.js';
import { Columns, Drop, HowRead, bindingsOf, saidOf, useReading } from '../parts/reading.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Linked } from '../parts/linked.js';
import { NotSaved } from '../parts/screens.js';

const KIND = 'room';
/** Of so many rooms every pair is shown; of more only those that move together. */
const ALL_PAIRS = 12;
/** The model that uses most of what a file has. */
const modelFor = channels => (channels.includes('T_forward') ? 'room3' : 'room2');

/** Pairs of rooms, those that look like neighbours first and marked. */
function pairsOf(rooms, neighbours) {
  const proposed = neighbours.map(pair => ({ ...pair, use: true }));
  if (rooms.length > ALL_PAIRS) return proposed;
  const all = rooms.flatMap(({ id: one }, at) => rooms.slice(at + 1).map(({ id: other }) => [one, other]));
  const isProposed = ([one, other]) => proposed.some(({ rooms: pair }) => pair.includes(one) && pair.includes(other));
  return [...proposed, ...all.filter(pair => !isProposed(pair)).map(pair => ({ rooms: pair, correlation: null, use: false }))];
}

export function NewSystem() {
  const models = useList('/models');
  const reading = useReading();
  const known = models.data ?? [{ id: 'room2', title: '' }];
  const rooms = reading.data?.rooms ?? [];
  return html`<h1>Add systems</h1>
    <section class="card">
      <h2>From a file</h2>
      ${reading.body === null ? html`<${Drop} take=${reading.take} />` : html`<p class="row end"><button onClick=${reading.leave}>Leave it</button></p>`}
      <${HowRead} of=${reading} />
      ${reading.data && html`<${Rooms} key=${reading.data} reading=${reading} models=${known}
        proposed=${rooms.length ? rooms : [{ id: 'new', label: '', column: null }]} />`}
    </section>
    ${reading.body === null && html`<${ByName} models=${known} />`}`;
}

/** The rooms of a file: those that are confirmed are added with their measurements, and with each other as neighbours. */
function Rooms({ reading, proposed, models }) {
  const { body, data, columns, zone } = reading;
  const several = proposed.length > 1;
  const [rooms, setRooms] = useState(proposed.map(room => ({ ...room, use: true })));
  const [pairs, setPairs] = useState(pairsOf(several ? proposed : [], data.neighbours));
  const [model, setModel] = useState(modelFor(data.columns.map(({ channel }) => channel)));
  const [made, setMade] = useState([]);
  const [error, setError] = useState(null);
  const [busy, setBusy] = useState(false);
  const change = (list, set) => (at, what) => set(list.map((entry, index) => (index === at ? { ...entry, ...what } : entry)));
  const changeRoom = change(rooms, setRooms);
  const changePair = change(pairs, setPairs);
  const used = rooms.filter(({ use }) => use);
  const original = Object.fromEntries(rooms.map((room, at) => [proposed[at].id, room]));
  const besides = id => pairs.filter(pair => pair.use && pair.rooms.includes(id)).map(pair => pair.rooms.find(other => other !== id)).filter(other => original[other]?.use);
  const documentOf = (room, id) => {
    const own = columns.filter(column => column.use && (column.room === null || column.room === id));
    const neighbours = besides(id).map(other => original[other]);
    const next = neighbours.map(other => {
      const column = columns.find(({ room: of, channel, use }) => use && of !== null && original[of] === other && channel === 'T_room');
      return column && { ...column, channel: `T_room_${other.id}` };
    });
    return {
      label: room.label,
      model,
      channels: bindingsOf([...own, ...next.filter(Boolean)]),
      neighbours: neighbours.map(other => `${KIND}/${other.id}`),
      ...(zone && data.dialect.local && { location: { zone } }),
    };
  };
  const add = async event => {
    event.preventDefault();
    setBusy(true);
    setError(null);
    const done = [...made];
    try {
      for (const [at, room] of rooms.entries()) {
        const system = `${KIND}/${room.id}`;
        if (!room.use || done.includes(system)) continue;
        await put(`/systems/${system}`, documentOf(room, proposed[at].id), { isNew: true });
        await ask(withQuery(`/systems/${system}/windows`, saidOf(reading, 'bound')), { method: 'POST', csv: body });
        done.push(system);
        setMade([...done]);
      }
      say(`${done.join(', ')} ${done.length === 1 ? 'is' : 'are'} there with ${done.length === 1 ? 'its' : 'their'} measurements`);
      if (!several) go(systemAddress(done[0], 'missing'));
    } catch (fault) {
      setError(fault);
    }
    setBusy(false);
  };
  const look = kind => post('/jobs', { kind, systems: made }).then(batch => go(address(['batches', batch.id])), sayFault);
  if (several && made.length > 0 && made.length === used.length)
    return html`<div class="outcome"><p class="says">${made.length} rooms are there with their measurements: <${Linked} systems=${made}
      to=${system => systemAddress(system, 'data')} />.</p>
      <p class="row"><button class="main" onClick=${() => look('diagnose')}>Find what is missing in all of them</button><button
        onClick=${() => look('recalibrate')}>Fit them for the controller</button></p></div>`;
  const named = Object.fromEntries(rooms.map(room => [room.id, room.label]));
  return html`<form onSubmit=${add}>
    <${Table} caption=${several ? 'Rooms that share the file' : 'The room'} columns=${[...(several ? [['add']] : []), ['name'], ['what people call it'], ...(several ? [['its temperature'], ['beside']] : [])]}
      rows=${rooms.map((room, at) => [
        ...(several ? [html`<input type="checkbox" aria-label=${`Add ${proposed[at].label}`} checked=${room.use} onChange=${event => changeRoom(at, { use: event.target.checked })} />`] : []),
        html`<span class="nowrap">${KIND}/<input aria-label=${`Name of ${proposed[at].label || 'the room'}`} required pattern="[A-Za-z0-9_\\-]{1,64}" value=${room.id} onInput=${event => changeRoom(at, { id: event.target.value })} /></span>`,
        html`<input aria-label=${`What people call ${proposed[at].label || 'it'}`} value=${room.label} placeholder="Living room" onInput=${event => changeRoom(at, { label: event.target.value })} />`,
        ...(several ? [room.column, besides(proposed[at].id).map(id => original[id].label).join(', ') || 'nobody'] : []),
      ])} />
    ${pairs.length > 0 && html`<details><summary>Which rooms are next door: ${pairs.filter(({ use }) => use).length} of ${pairs.length} pairs</summary>
      <p class="quiet">Rooms next door warm each other. Those that move together are marked; you know the plan better.</p>
      <ul>${pairs.map((pair, at) => html`<li><label class="inline"><input type="checkbox" checked=${pair.use}
        onChange=${event => changePair(at, { use: event.target.checked })} /> ${pair.rooms.map(id => original[id].label).join(' beside ')}${pair.correlation === null ? '' : `, correlation ${pair.correlation.toFixed(2)}`}</label></li>`)}</ul></details>`}
    <label class="inline">Model <select value=${model} onChange=${event => setModel(event.target.value)}>
      ${models.map(({ id, title }) => html`<option value=${id} selected=${id === model}>${id}: ${title}</option>`)}</select></label>
    <details><summary>Columns: ${columns.filter(({ use }) => use).length} of ${columns.length} are used</summary><${Columns} of=${reading}
      rooms=${several ? rooms.map((room, at) => ({ id: proposed[at].id, label: named[room.id] })) : null} /></details>
    ${made.length > 0 && html`<p><${Status} of="ok" label=${`${made.length} of ${used.length} are there`} /></p>`}
    ${error && html`<${NotSaved} error=${error}><p>There is a system of that name already, and nothing of it was changed. Choose another
      name.</p></${NotSaved}>`}
    <p class="row end"><button class="main" disabled=${busy || used.length === 0}>${several ? `Add ${used.length} rooms with their measurements` : 'Add it with its measurements'}</button></p>
  </form>`;
}

/** A system without measurements yet. */
function ByName({ models }) {
  const [draft, setDraft] = useState({ system: 'room/', label: '', model: 'room2' });
  const [error, setError] = useState(null);
  const set = name => event => setDraft({ ...draft, [name]: event.target.value });
  const make = async event => {
    event.preventDefault();
    try {
      await put(`/systems/${draft.system}`, { label: draft.label, model: draft.model }, { isNew: true });
      say(`${draft.system} is there`);
      go(systemAddress(draft.system, 'data'));
    } catch (fault) {
      setError(Object.assign(fault, { system: draft.system }));
    }
  };
  return html`<form class="card" style="max-width:32rem" onSubmit=${make}>
      <h2>By a name</h2>
      <label>Name: its kind and a number or word<input value=${draft.system} required pattern="[a-z]{1,32}/[A-Za-z0-9_\\-]{1,64}"
        placeholder="room/6" onInput=${set('system')} /></label>
      <label>What people call it<input value=${draft.label} placeholder="Living room" onInput=${set('label')} /></label>
      <label>Model<select value=${draft.model} onChange=${set('model')}>
        ${models.map(model => html`<option value=${model.id} selected=${model.id === draft.model}>${model.id}: ${model.title}</option>`)}</select></label>
      ${error && html`<${NotSaved} error=${error}><p>There is a system ${error.system} already, and nothing of it was changed. Choose another name,
        or <a href=${systemAddress(error.system, 'settings')}>change the settings of ${error.system}</a>.</p></${NotSaved}>`}
      <p class="row end"><button class="main">Add it and upload measurements</button></p>
    </form>`;
}
