// Batches by what they are, and how their systems stand, in words.
import { html } from '../html.js';
import { clock, sentence, words } from '../format.js';
import { Status } from './status.js';
import { Table } from './table.js';

const DOES = { recalibrate: 'recalibration', diagnose: 'diagnosis' };
/** The schedule of the service itself is known by its name. */
const NIGHTLY = 'nightly';

/** `Nightly recalibration of 300 systems, 26 Nov 2026, 02:00`. */
export function batchName({ kind, schedule, created_at: at }, systems) {
  const what = `${DOES[kind] ?? words(kind)} of ${systems} ${systems === 1 ? 'system' : 'systems'}`;
  const named = schedule === NIGHTLY ? `${NIGHTLY} ${what}` : what;
  return `${sentence(named)}, ${clock(at)}${schedule && schedule !== NIGHTLY ? `, by the schedule ${schedule}` : ''}`;
}

/** How a system of a batch may stand: the state, the outcome of a fit, the verdict of a diagnosis. The good news first. */
const STANDS = {
  accepted: 'new parameters',
  unchanged: 'good already',
  adequate: 'nothing is missing',
  named: 'something with a name is missing',
  unknown: 'something that no effect explains is missing',
  not_enough_data: 'too few data to tell',
  suggested: 'a fit waits for an operator’s word',
  held: 'the gate holds the fit',
  rejected: 'refused',
  failed: 'failed',
  cancelled: 'called off',
  succeeded: 'done',
  running: 'runs',
  queued: 'waits',
};

const LONGEST_BAR_REM = 16;

/** Where a job of a batch stands, in one word. */
export const standing = ({ state, outcome, verdict }) => verdict ?? outcome ?? state;

/** How many systems stand how, with bars. */
export function Standings({ jobs }) {
  const counts = new Map();
  for (const job of jobs) counts.set(standing(job), (counts.get(standing(job)) ?? 0) + 1);
  const most = Math.max(...counts.values());
  const rows = Object.keys(STANDS).filter(word => counts.has(word));
  return html`<${Table} caption="Systems by what became of them" columns=${[['what'], ['systems', 'number'], ['']]}
    rows=${rows.map(word => [
      html`<${Status} of=${word} label=${STANDS[word]} />`,
      counts.get(word),
      html`<span class="bar" style=${{ width: `${(LONGEST_BAR_REM * counts.get(word)) / most}rem` }}></span>`,
    ])} />`;
}

/** A sentence of the gate as `[who, what]`: `G4 beats persistence` and why; of others only what was said. */
function parted(why) {
  const [, check, says] = /^(?:rejected|held) by (G\d+ [^:]+): (.*)$/s.exec(why) ?? [];
  return check ? [check, says] : ['', why];
}

/** Reasons that are equal but for their numbers, the most frequent first: `{key, reason, example, systems}`. */
export function grouped(rows) {
  const groups = new Map();
  for (const { system, word, why } of rows) {
    const [reason, example] = parted(why ?? 'nothing was said');
    const key = `${word} ${reason || example.replaceAll(/\d+(\.\d+)?/g, '#')}`;
    const group = groups.get(key) ?? { key, word, reason, example, systems: [] };
    group.systems.push(system);
    groups.set(key, group);
  }
  return [...groups.values()].sort((one, other) => other.systems.length - one.systems.length);
}
