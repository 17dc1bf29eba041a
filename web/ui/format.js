// Numbers, times and lengths of time as people read them.

export const NONE = '–';
/** The unit of errors that count several outputs together, each in the noise of its sensor. */
export const NOISE = '× noise';

/** A number with three significant figures, or a dash. */
export function number(value, figures = 3) {
  if (!Number.isFinite(value)) return NONE;
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size >= 1e5 || size < 1e-4) return value.toExponential(Math.max(figures - 1, 0));
  return size >= 10 ** figures ? String(Math.round(value)) : String(Number(value.toPrecision(figures)));
}

/**
 * How many decimals a reading of these values deserves: a thousandth of what they vary by, four digits that count, of
 * temperatures two or three decimals, else no more than the values themselves have.
 */
export function decimalsOfAll(values, unit) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) {
    if (!Number.isFinite(value)) continue;
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  const most = Math.max(Math.abs(low), Math.abs(high));
  if (!(most > 0) || most === Infinity) return 0;
  const places = (size, digits) => (size > 0 ? digits - Math.ceil(Math.log10(size)) : 0);
  const [least, finest] = unit === 'K' || unit === 'degC' ? [2, 3] : [0, 8];
  const decimals = Math.min(Math.max(places(high - low, 3), places(most, 4), least), finest);
  const finer = [...Array(decimals).keys()].slice(least);
  const enough = places => values.every(value => !Number.isFinite(value) || Math.abs(value - Number(value.toFixed(places))) < 0.05 * 10 ** -decimals);
  return finer.find(enough) ?? decimals;
}

/** A reading with so many decimals, or a dash. */
export const reading = (value, decimals) =>
  Number.isFinite(value) ? value.toFixed(decimals).replace(/^-(0\.?0*)$/, '$1') : NONE;

/** How many decimals an error has: two, and below 0.1 as many as show two digits that count, but no more than four. */
function decimalsOf(value) {
  const size = Math.abs(value);
  if (size >= 0.0995 || size < 0.0005) return 2;
  return size >= 0.00995 ? 3 : 4;
}

/** An error as it stands beside others. */
export const fixed = value => reading(value, decimalsOf(value));

export const signed = (value, decimals = decimalsOf(value ?? 0)) =>
  Number.isFinite(value) ? `${value > 0 ? '+' : value < 0 ? '−' : ''}${Math.abs(value).toFixed(decimals)}`.replace(/^[+−](0\.?0*)$/, '$1') : NONE;

export const percent = value => (Number.isFinite(value) ? `${Math.round(value * 100)} %` : NONE);

/** A unit as it stands behind a number; a ratio has none. */
export const unitOf = unit => (unit === '-' ? '' : unit);

/** How often chance alone would do it; what is rarer than once in a thousand is told as that. */
export const chance = p => (p !== null && p < 0.001 ? '< 0.001' : number(p, 2));

/** Seconds as `7 h`, `3 d`, `10 ms`. */
export function length(seconds) {
  if (seconds === null || seconds === undefined) return NONE;
  if (seconds < 1) return seconds >= 0.001 ? `${Math.round(1000 * seconds)} ms` : 'less than 1 ms';
  if (seconds < 90) return `${Math.round(seconds)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  if (seconds < 48 * 3600) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} d`;
}

/** Seconds that are only expected, no finer than they are known: `30 s`, `2 min`, `25 min`. */
export function roughly(seconds) {
  if (seconds === null || seconds === undefined) return NONE;
  if (seconds < 8) return 'a few seconds';
  if (seconds < 55) return `${Math.round(seconds / 10) * 10} s`;
  if (seconds < 570) return `${Math.round(seconds / 60)} min`;
  if (seconds < 3300) return `${Math.round(seconds / 300) * 5} min`;
  return `${Math.round(seconds / 3600)} h`;
}

/** How long ago an instant was, or how long it takes until it is. */
export function fromNow(instant) {
  if (!instant) return NONE;
  const seconds = (Date.now() - Date.parse(instant)) / 1000;
  if (Math.abs(seconds) < 1) return 'now';
  return seconds >= 0 ? `${length(seconds)} ago` : `in ${length(-seconds)}`;
}

const formats = new Map();
function format(zone) {
  if (!formats.has(zone)) {
    formats.set(
      zone,
      new Intl.DateTimeFormat('en-GB', {
        timeZone: zone,
        day: 'numeric',
        month: 'short',
        year: 'numeric',
        hour: '2-digit',
        minute: '2-digit',
      }),
    );
  }
  return formats.get(zone);
}

/** An instant on the clock of a zone, UTC where nothing else is known. */
export const clock = (instant, zone = 'UTC') => (instant ? format(zone).format(new Date(instant)) : NONE);

/** The day of an instant in UTC. */
export const day = at =>
  new Intl.DateTimeFormat('en-GB', { timeZone: 'UTC', day: 'numeric', month: 'short', year: 'numeric' }).format(
    new Date(typeof at === 'number' ? at * 1000 : at),
  );

/** `PT24H` as `24 h`. */
export function horizon(text) {
  const match = /^P(?:(\d+)D)?(?:T(?:(\d+)H)?(?:(\d+)M)?)?$/.exec(text ?? '');
  if (!match) return text === 'free_run' ? 'free run' : String(text);
  const [, days, hours, minutes] = match;
  return [days && `${days} d`, hours && `${hours} h`, minutes && `${minutes} min`].filter(Boolean).join(' ');
}

/** The hours of `PT6H` or `P2D`. */
export function hoursOf(text) {
  const [, days, hours] = /^P(?:(\d+)D)?(?:T(\d+)H)?$/.exec(text) ?? [];
  return 24 * Number(days ?? 0) + Number(hours ?? 0);
}

/** How a number lies to its limit. */
export const operator = text => ({ '<=': '≤', '>=': '≥' })[text] ?? text;

/** `barely_better_than_persistence` as words. */
export const words = text => (text ?? '').replaceAll('_', ' ');

/** A text as the beginning of a sentence. */
export const sentence = text => text[0].toUpperCase() + text.slice(1);

/** A check of the gate such as `G4 beats persistence`: its rule, and its name as the beginning of a sentence. */
export function checkOf(name) {
  const [, rule = null, rest] = /^(G\d+) (.*)$/.exec(name) ?? [null, null, name];
  return { rule, name: sentence(rest) };
}

/** The title of a parameter; a member of a family such as `alpha_n[81]` has that of `alpha_n`. */
export const titleFor = (symbol, titles) => titles[symbol] ?? titles[symbol.split('[')[0]];

/** A parameter as people call it, with its symbol where both are known. */
export const named = (symbol, titles) => (titleFor(symbol, titles) ? `${titleFor(symbol, titles)} (${symbol})` : symbol);

/**
 * A sentence of the service without its codes: instants on the clock of a zone, `PT6H` as `6 h`, `G4 beats persistence` as
 * its name, `at_bound:alpha_e` in words, and parameters by their titles.
 */
export function plainly(text, { zone = 'UTC', titles = {} } = {}) {
  // A symbol of one letter may as well be a word.
  const symbols = Object.keys(titles)
    .filter(symbol => symbol.length > 1)
    .map(symbol => symbol.replaceAll(/[^\w]/g, '\\$&'));
  const flags = /\b(at_bound|non_identifiable|undetermined|unseen|waived):([\w[\]]+)/g;
  const said = (text ?? '')
    .replaceAll(/\d{4}-\d\d-\d\dT[\d:.]+Z/g, at => clock(at, zone))
    .replaceAll(/\bP(?:\d+D)?(?:T\d+[HM])?\b/g, code => (code.length > 1 ? horizon(code) : code))
    .replaceAll(/\bby G\d+ ([^:;]+)/g, 'by the check “$1”')
    .replaceAll(/\bG\d+ (?=[a-z])/g, '')
    .replaceAll(flags, (_, kind, symbol) => `${words(kind)}: ${symbol.length > 1 ? symbol : named(symbol, titles)}`)
    .replaceAll(/\b(free_run|barely_better_than_persistence|low_confidence|promoted_by_operator)\b/g, words);
  if (symbols.length === 0) return said;
  return said.replaceAll(new RegExp(`(?<![\\w/:+(])(?:${symbols.join('|')})(?:\\[\\w+\\])?(?![\\w:+[])`, 'g'), symbol => named(symbol, titles));
}

/** What is said of a fit that passed and that nobody has published yet. */
export const WAITS = 'waits for your word';

/** How a fit is called in a list. */
export const fitName = fit => `${clock(fit.created_at)} ${fit.model} (${fit.served ? 'served' : fit.waits_for_operator ? WAITS : (fit.verdict ?? 'not judged')})`;

export const seconds = instant => Date.parse(instant) / 1000;
export const instant = at => new Date(Math.round(at) * 1000).toISOString().replace('.000Z', 'Z');
