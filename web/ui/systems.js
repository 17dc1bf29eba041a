// The rows of all systems: read once, page by page, and kept while one goes from page to page. What happens to a system
// makes its own row anew, and no other.
import { useState, useEffect } from './html.js';
import { ask, eachPage, withQuery, AGAIN } from './api.js';
import { REPORT } from './carried.js';
import { onEvents } from './events.js';

/** So many rows are asked for again at once, this often: a batch of hundreds stays below 10 kB a second. */
const AGAIN_AT_ONCE = 8;
const AGAIN_MS = 1000;
/** Where more rows than these are due, all of them are read. */
const MOST_DUE = 400;

export const SEVERITY = { bad: 0, attention: 1, unknown: 2, ok: 3 };
const inOrder = new Intl.Collator('en', { numeric: true }).compare;

let kept = { rows: null, complete: false, error: null, running: new Map() };
let reading = 0;
let timer = null;
const due = new Set();
const listeners = new Set();

function publish(change) {
  kept = { ...kept, ...change };
  listeners.forEach(listener => listener(kept));
}

/** Whether somebody is to do something about a system. */
export const needsSomebody = row => !['none', 'wait'].includes(row.next.code);

/** A row with what is sorted and searched by. */
function prepared(row) {
  const { quality } = row;
  row.kind = row.system.split('/')[0];
  row.severity = SEVERITY[row.health];
  row.size = quality?.ahead ?? quality?.validation_rmse ?? null;
  // Where nothing is to be done, every system is by itself.
  row.step = needsSomebody(row) ? `${row.health} ${row.next.code} ${row.next.text}` : row.system;
  row.text = [row.system, row.label, row.group, row.model, row.health, row.why, row.next.text, row.status, ...row.flags]
    .join(' ')
    .toLowerCase();
  return row;
}

/** All of them by name, `room/2` before `room/10`; each knows its place. */
function ordered(bySystem) {
  const rows = [...bySystem.values()].sort((a, b) => inOrder(a.system, b.system));
  rows.forEach((row, at) => {
    row.order = at;
  });
  return rows;
}

async function read() {
  reading += 1;
  const turn = reading;
  const found = new Map();
  const take = ({ items, next_page_token: more }) => {
    if (turn !== reading) return false;
    for (const row of items) found.set(row.system, prepared(row));
    // The first of them can be looked at while the others come.
    if (more && kept.rows === null) publish({ rows: ordered(found) });
    return true;
  };
  due.clear();
  try {
    await eachPage(withQuery('/systems', { with: 'trend' }), take);
    if (turn === reading) publish({ rows: ordered(found), complete: true, error: null });
  } catch (error) {
    if (turn === reading) publish({ rows: null, complete: false, error });
  }
}

/** Makes some of the rows anew that something has happened to; says whether it could. */
async function readDue() {
  const names = [...due].slice(0, AGAIN_AT_ONCE);
  names.forEach(name => due.delete(name));
  const turn = reading;
  try {
    const { items } = await ask(withQuery('/systems', { systems: names.join(','), with: 'trend' }));
    // Whoever reads all of them meanwhile has newer ones.
    if (turn !== reading || !kept.complete) return true;
    const bySystem = new Map(kept.rows.map(row => [row.system, row]));
    names.forEach(name => bySystem.delete(name));
    items.forEach(row => bySystem.set(row.system, prepared(row)));
    publish({ rows: ordered(bySystem) });
    return true;
  } catch {
    // The next event, or the next visit, tries again.
    names.forEach(name => due.add(name));
    return false;
  }
}

/** After a moment, for all that comes within it; while nobody looks, what is due waits. */
function soon() {
  if (timer !== null || listeners.size === 0) return;
  timer = setTimeout(async () => {
    timer = null;
    publish({ running: kept.running });
    if (due.size > MOST_DUE) await read();
    else if (due.size > 0 && kept.complete && !(await readDue())) return;
    if (due.size > 0) soon();
  }, AGAIN_MS);
}

function hear(kind, data) {
  if (kind === 'incumbent') return;
  if (kind === 'finished') {
    kept.running.delete(data.system);
    due.add(data.system);
  } else {
    kept.running.set(data.system, kind === 'progress' ? `${data.evaluations} evaluations` : kind === 'queued' ? 'waits' : 'runs');
  }
  soon();
}
onEvents(hear);

/** Makes the row of a system anew that was changed here. */
export function refresh(system) {
  due.add(system);
  soon();
}

/**
 * `{rows, complete, error, running, reload}`: `rows` is null before the first answer and in a report, `running` says of what
 * a job runs.
 */
export function useSystems() {
  const [state, setState] = useState(kept);
  useEffect(() => {
    if (REPORT) return undefined;
    listeners.add(setState);
    addEventListener(AGAIN, read);
    if (kept.rows === null || due.size > MOST_DUE) read();
    else if (due.size > 0) soon();
    setState(kept);
    return () => {
      listeners.delete(setState);
      removeEventListener(AGAIN, read);
    };
  }, []);
  return { ...state, reload: read };
}
