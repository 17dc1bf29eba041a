// One effect for many rooms: each tries it on its own data, and takes it only where unseen data and the gate say yes.
//
// How far each room is stands in the browser, so that a page that was closed goes on where it was. The service holds
// nothing of it but ordinary fits and documents: whatever breaks off leaves every room with what it had.
import { html, useEffect, useRef, useState } from '../html.js';
import { ask, post, putSystem } from '../api.js';
import { address, systemAddress } from '../router.js';
import { hasEnded } from '../events.js';
import { say, sayFault } from '../say.js';
import { fixed, NONE, WAITS } from '../format.js';
import { experiment, grownFrom, FALL } from '../parts/experiment.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';

const KEY = 'lampyris-adopting';
/** Rooms that are worked on at a time: what the service fits beside them keeps its turn. */
const AT_ONCE = 3;
const LOOK_MS = 1500;
/** Whoever waits for so long waits for another tab. */
const ELSEWHERE_MS = 3000;
const DONE = ['adopted', 'waits', 'refused', 'failed'];
/** How far a room is: which status that looks like, and what is said. */
const STATES = {
  queued: ['queued', 'waits for its turn'],
  trying: ['running', 'tries it, with the model it has beside it'],
  fitting: ['running', 'is fitted for the controller'],
  adopted: ['ok', 'adopted'],
  waits: ['held', WAITS],
  refused: ['cancelled', 'keeps its model'],
  failed: ['failed', 'failed'],
};

/** What was begun and not closed, also before this page was loaded. */
export function adoption() {
  try {
    return JSON.parse(localStorage.getItem(KEY));
  } catch {
    return null;
  }
}

function keep(state) {
  try {
    if (state === null) localStorage.removeItem(KEY);
    else localStorage.setItem(KEY, JSON.stringify(state));
  } catch {
    // Without a memory it goes on for as long as the page is open.
  }
}

/** Begins with an effect: `rooms` are `{system, diagnosis, members}`. */
export function begin(effect, rooms) {
  const state = {
    id: `${effect.effect} ${Date.now()}`,
    effect: effect.effect,
    title: effect.title,
    rooms: rooms.map(room => ({ ...room, state: 'queued' })),
  };
  keep(state);
  return state;
}

const pause = ms => new Promise(done => setTimeout(done, ms));

/** The job when it has ended. */
async function ended(id, signal) {
  for (;;) {
    signal.throwIfAborted();
    try {
      const job = await ask(`/jobs/${id}`, { signal });
      if (hasEnded(job)) return job;
    } catch (error) {
      // A service that restarts is there again in a moment, and the job with it.
      if (error.name === 'AbortError' || (error.status > 0 && error.status < 500)) throw error;
    }
    await pause(LOOK_MS);
  }
}

/** The errors of the first output. */
const errorsOf = fit => Object.values(fit.metrics)[0];

const fitOf = async (job, signal) => {
  if (!job.fit) throw new Error(job.error?.detail ?? `a job has ${job.state}`);
  return ask(`/fits/${job.fit}`, { signal });
};

/** Fits the model that a room has and the grown one on the same data; says why the grown one is not taken, or nothing. */
async function tried(room, note, signal) {
  if (!room.grown) {
    const document = await ask(`/systems/${room.system}`, { signal });
    const added = room.members.filter(member => !document.model.split('+').includes(member));
    if (added.length === 0) return 'its model has it already';
    const diagnosis = await ask(`/diagnoses/${room.diagnosis}`, { signal });
    const { request } = await ask(`/jobs/${diagnosis.job}`, { signal });
    const grown = await grownFrom(document.model, added);
    const jobs = [];
    for (const model of [document.model, grown]) jobs.push((await experiment(room.system, model, request)).id);
    note({ state: 'trying', model: document.model, grown, jobs });
  }
  const [before, after] = await Promise.all(room.jobs.map(async job => fitOf(await ended(job, signal), signal)));
  const [had, has] = [before, after].map(errorsOf);
  note({ before: had.validation_rmse, after: has.validation_rmse, unit: had.unit });
  if (!(has.validation_rmse < had.validation_rmse * FALL)) return 'the error on unseen data falls by less than one per cent';
  // The part that no decision has seen may not speak against it.
  if (has.test_rmse > had.test_rmse) return 'it falls there, and rises on the data that nothing was decided by';
  return after.verdict === 'accepted' ? null : `the gate: ${after.summary}`;
}

/** Gives a room the model back that it had, where it still has the grown one. */
async function back(room, signal) {
  const document = await ask(`/systems/${room.system}`, { signal });
  if (document.model === room.grown) await putSystem(document, { ...document, model: room.model });
}

/** Makes the grown model that of the room and fits it for the controller. Where the gate says no, the model goes back. */
async function served(room, note, signal) {
  if (!room.job) {
    const document = await ask(`/systems/${room.system}`, { signal });
    if (document.model !== room.grown) {
      if (document.model !== room.model) return { state: 'refused', why: 'somebody has changed its model meanwhile' };
      await putSystem(document, { ...document, model: room.grown });
    }
    note({ state: 'fitting', job: (await post('/jobs', { kind: 'estimate', system: room.system })).id });
  }
  const job = await ended(room.job, signal);
  if (job.outcome === 'accepted') return { state: 'adopted', why: `revision ${job.revision}` };
  if (job.outcome === 'suggested') return { state: 'waits', why: 'its policy leaves every fit to an operator' };
  const fit = job.fit ? await ask(`/fits/${job.fit}`, { signal }) : null;
  await back(room, signal);
  return { state: 'refused', why: `the gate, on the newest data: ${fit?.summary ?? job.error?.detail ?? job.state}` };
}

/** Takes a room through to its end; `note` keeps how far it is. */
async function adopt(room, note, signal) {
  try {
    const why = room.state === 'fitting' ? null : await tried(room, note, signal);
    note(why ? { state: 'refused', why } : await served(room, note, signal));
  } catch (error) {
    if (error.name === 'AbortError') throw error;
    const why = error.errors?.[0]?.detail ?? error.detail ?? error.message;
    // A room that cannot even go back has not ended: whoever opens the page again goes on with it.
    const isBack = !room.grown || (await back(room, signal).then(() => true, () => false));
    note(isBack ? { state: 'failed', why } : { why: `${why}; this page goes on with it when it is opened again` });
  }
}

/** One tab goes on with it at a time, where the browser can tell; the others wait until that one is closed. */
const alone = (signal, act) => (navigator.locks ? navigator.locks.request(KEY, { signal }, act) : act());

export function Adopting({ start, changed, close }) {
  const [rooms, setRooms] = useState(start.rooms);
  const [elsewhere, setElsewhere] = useState(false);
  const current = useRef(start.rooms);
  const left = useRef([]);
  const note = (room, change) => {
    Object.assign(room, change);
    // What was closed is not written down again, and what happens behind a page that was left is.
    if (adoption()?.id === start.id) keep({ ...start, rooms: current.current });
    setRooms([...current.current]);
  };
  useEffect(() => {
    const abort = new AbortController();
    const work = async () => {
      while (left.current.length > 0) {
        const room = left.current.shift();
        await adopt(room, change => note(room, change), abort.signal);
        changed(room.system);
      }
    };
    const waits = setTimeout(() => setElsewhere(true), ELSEWHERE_MS);
    alone(abort.signal, async () => {
      clearTimeout(waits);
      setElsewhere(false);
      // Another tab may have come further meanwhile.
      current.current = adoption()?.rooms ?? current.current;
      left.current = current.current.filter(room => !DONE.includes(room.state));
      if (left.current.length === 0) return;
      await Promise.all(Array.from({ length: AT_ONCE }, work));
      say(summaryOf(start.title, current.current));
    }).catch(error => error.name !== 'AbortError' && sayFault(error));
    return () => {
      clearTimeout(waits);
      abort.abort();
    };
  }, []);
  useEffect(() => {
    // What another tab writes down is shown here.
    const heard = event => event.key === KEY && adoption()?.id === start.id && setRooms((current.current = adoption().rooms));
    addEventListener('storage', heard);
    return () => removeEventListener('storage', heard);
  }, []);
  const leave = () => {
    keep(null);
    close();
  };
  // Rooms that are under way go to their end: none is left with a model that the gate has refused.
  const stop = () => left.current.splice(0).forEach(room => note(room, { state: 'refused', why: 'stopped before its turn' }));
  const done = rooms.filter(room => DONE.includes(room.state)).length;
  const isDone = done === rooms.length;
  return html`<section class="card" aria-labelledby="adopting">
    <div class="row apart"><h2 id="adopting">${start.title} in ${rooms.length} ${rooms.length === 1 ? 'room' : 'rooms'}</h2>
      ${isDone ? html`<button onClick=${leave}>Close</button>` : !elsewhere && html`<button onClick=${stop}>Stop behind those under way</button>`}</div>
    <p>Each room is fitted with the model it has and with ${start.title} added, on the same data. It takes the effect only where the error on unseen
      data falls and the gate accepts the fit; then it is fitted to the newest data for the controller, and the gate decides once more. A room that is
      refused keeps what it has.</p>
    ${elsewhere && html`<p class="note">▲ Another tab of this browser goes on with it.</p>`}
    ${!isDone && html`<progress max=${rooms.length} value=${done} aria-label="Rooms that are done"></progress>`}
    <p role="status">${isDone ? html`<${Status} of="ok" label=${summaryOf(start.title, rooms)} />` : `${done} of ${rooms.length} rooms are done.`}</p>
    <${Table} caption="Room by room" columns=${[['room'], ['how far'], ['before', 'number'], ['after', 'number'], ['why']]}
      keys=${rooms.map(room => room.system)} rows=${rooms.map(room => [
        html`<a href=${systemAddress(room.system, 'missing')}>${room.system}</a>`,
        html`<${Status} of=${STATES[room.state][0]} label=${STATES[room.state][1]} />`,
        error(room.before, room.unit),
        error(room.after, room.unit),
        html`${room.why ?? ''} ${room.job && html`<a href=${address(['jobs', room.job])}>fit</a>`}`,
      ])} />
  </section>`;
}

const error = (value, unit) => (value === undefined ? NONE : `${fixed(value)} ${unit}`);
const mean = values => values.reduce((sum, value) => sum + value, 0) / values.length;

/** What it came to: how many took it, what their errors were, and why the others did not. */
function summaryOf(title, rooms) {
  const of = state => rooms.filter(room => room.state === state);
  const adopted = of('adopted');
  const errors = adopted.length
    ? `; their error on unseen data went from ${fixed(mean(adopted.map(room => room.before)))} to ${fixed(mean(adopted.map(room => room.after)))} ${adopted[0].unit}${adopted.length > 1 ? ' in the mean' : ''}`
    : '';
  const reasons = new Map();
  for (const room of [...of('refused'), ...of('failed')]) {
    // The gate names the rule before it says more.
    const reason = room.why.split(/(?<=G\d+[^:]*):/)[0];
    reasons.set(reason, (reasons.get(reason) ?? 0) + 1);
  }
  const others = [...reasons].map(([reason, count]) => `${count} did not (${reason})`);
  const waits = of('waits').length ? [`${of('waits').length} wait for your word`] : [];
  return `${title}: ${adopted.length} of ${rooms.length} took it${errors}${[...waits, ...others].map(text => `; ${text}`).join('')}.`;
}
