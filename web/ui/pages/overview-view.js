// What the overview shows of the rows: which of them, in which order, gathered into which groups, and which page of that.
import { SEVERITY } from '../systems.js';
import { seconds, words } from '../format.js';

/** Entries of a page. */
export const PAGE_SIZE = 50;
/** So many equal next steps are one line until somebody opens it. */
const FOLDED = 5;
/** Where there are more systems than these, other groups are closed as well at first. */
const MANY = 100;

const last = (value, sign) => (value === null || value === undefined || Number.isNaN(value) ? sign * Infinity : value);

/** The columns by which the table is sorted: the name in the address, the title, and what is compared. */
export const COLUMNS = [
  ['system', 'System', row => row.order],
  ['health', 'Health, and why', row => row.severity],
  ['served', 'Served', row => row.age_s],
  ['error', 'Forecast error', row => row.size, 'number'],
  ['validation', 'Validation', row => row.trend?.at(-1)],
  ['regime', 'Fails most', row => row.worst_regime],
  ['flags', 'Flags', row => row.flags.length],
  ['measured', 'Newest sample', row => seconds(row.measured_to)],
  ['run', 'Next fit', (row, nextRun) => seconds(nextRun(row))],
];

/** Where a system is: its group, or what kind it is of. */
export const placeOf = row => row.group || row.kind;

/** Whether a row lies in a group or below it; without a path everything does. */
export const isWithin = (row, path) => !path || placeOf(row) === path || row.group.startsWith(`${path}/`);

/** By what rows are gathered: the name in the address, the title, and the value of a row. */
export const GROUPINGS = [
  ['group', 'Group', placeOf],
  ['kind', 'Kind', row => row.kind],
  ['health', 'Health', row => row.health],
  ['model', 'Model', row => row.model ?? 'no model'],
  ['next', 'Next step', row => row.next.text],
];

/** The worst first: by health, then by the error, then by name. */
export const worstFirst = (a, b) => a.severity - b.severity || (b.size ?? 0) - (a.size ?? 0) || a.order - b.order;

/** All rows in the order that is asked for; whatever is left out later keeps it. */
export function sorted(all, sort, nextRun) {
  const rows = [...all];
  const descending = sort?.startsWith('-');
  const column = COLUMNS.find(([name]) => name === sort?.replace(/^-/, ''));
  if (!column) return rows.sort(worstFirst);
  const sign = descending ? -1 : 1;
  const values = new Map(rows.map(row => [row, last(column[2](row, nextRun), sign)]));
  // What has no value comes last, whichever way.
  const compared = (a, b) => {
    const [one, other] = [values.get(a), values.get(b)];
    if (one === other) return 0;
    if (typeof one !== typeof other) return typeof one === 'string' ? -sign : sign;
    return one < other ? -1 : 1;
  };
  return rows.sort((a, b) => sign * compared(a, b) || a.order - b.order);
}

/** The rows that are asked for. */
export function filtered(rows, { search, health, in: path, next }) {
  const wanted = (search ?? '').toLowerCase().split(/\s+/).filter(Boolean);
  return rows.filter(
    row =>
      (!health || row.health === health) &&
      (!next || row.next.code === next) &&
      isWithin(row, path) &&
      wanted.every(word => row.text.includes(word)),
  );
}

/** A few letters for a long name, for the address. */
function short(name) {
  let hash = 0;
  for (const letter of name) hash = (hash * 31 + letter.codePointAt(0)) | 0;
  return (hash >>> 0).toString(36);
}

const counted = rows => {
  const kinds = new Set(rows.map(row => row.kind));
  const word = kinds.size === 1 ? [...kinds][0] : 'system';
  return `${rows.length} ${rows.length === 1 ? word : `${word}s`}`;
};

const groupOf = (by, name, rows, isClosed) => {
  const key = short(`${by} ${name}`);
  const alike = rows.every(row => row.next.code === rows[0].next.code && row.next.text === rows[0].next.text);
  const one = rows.every(row => row.why === rows[0].why) ? rows[0].why : rows[0].next.text;
  const says = by === 'next' ? `${counted(rows)}: ${one}` : `${by === 'health' ? words(name) : name}: ${counted(rows)}`;
  return { head: key, by, name, rows, says, isClosed, next: alike ? rows[0].next : null };
};

function gathered(rows, name) {
  const groups = new Map();
  for (const row of rows) {
    const key = name(row);
    if (groups.has(key)) groups.get(key).push(row);
    else groups.set(key, [row]);
  }
  return groups;
}

/**
 * The lines of the table: rows in their order, and heads of groups (`{head, says, rows, isClosed, next}`). Without a
 * grouping and with the worst first, systems that need the same of somebody are one line.
 */
export function lines(order, query) {
  const toggled = new Set((query.open ?? '').split('.').filter(Boolean));
  const grouping = GROUPINGS.find(([name]) => name === query.by);
  if (!grouping && query.sort) return order;
  const groups = [...gathered(order, grouping ? grouping[2] : row => row.step)];
  // Groups with the worst member first; of equal ones by name.
  const worst = members => Math.min(...members.map(row => SEVERITY[row.health]));
  if (grouping && grouping[0] !== 'next')
    groups.sort(([a, x], [b, y]) => (grouping[0] === 'health' ? worst(x) - worst(y) : a.localeCompare(b, 'en', { numeric: true })));
  return groups.flatMap(([name, members]) => {
    const many = members.length >= FOLDED;
    if (!grouping && !many) return members;
    const by = grouping?.[0] ?? 'next';
    const isClosed = (by === 'next' ? many : order.length > MANY) !== toggled.has(short(`${by} ${name}`));
    const head = groupOf(by, name, members, isClosed);
    return isClosed ? [head] : [head, ...members];
  });
}

/** The address of `open` after a group was opened or closed. */
export function toggledIn(open, key) {
  const keys = new Set((open ?? '').split('.').filter(Boolean));
  if (!keys.delete(key)) keys.add(key);
  return [...keys].join('.') || null;
}

/** When a system is fitted next, by the schedules that mean it: `room/*` or its name. */
export function runs(schedules) {
  const enabled = schedules.filter(schedule => schedule.enabled && schedule.next_runs.length > 0);
  const means = (pattern, system) =>
    pattern === system || (pattern.endsWith('*') && system.startsWith(pattern.slice(0, -1)));
  return row =>
    enabled
      .filter(schedule => schedule.systems.some(pattern => means(pattern, row.system)))
      .map(schedule => schedule.next_runs[0])
      .sort()[0] ?? null;
}
