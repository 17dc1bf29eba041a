// Clocks on the wall and the instants that they show. Where clocks change, a time comes twice, or never.

const DAY_MS = 86_400_000;
const formats = new Map();

/** The clock of a zone at an instant (ms), as `2026-03-29T03:00:00`. */
function wall(at, zone) {
  if (!formats.has(zone)) {
    const digits = { hourCycle: 'h23', year: 'numeric', month: '2-digit', day: '2-digit', hour: '2-digit', minute: '2-digit', second: '2-digit' };
    formats.set(zone, new Intl.DateTimeFormat('en-GB', { timeZone: zone, ...digits }));
  }
  const part = Object.fromEntries(formats.get(zone).formatToParts(at).map(({ type, value }) => [type, value]));
  return `${part.year.padStart(4, '0')}-${part.month}-${part.day}T${part.hour}:${part.minute}:${part.second}`;
}

/** How far the clock of a zone is ahead of UTC, in ms. */
const ahead = (at, zone) => Date.parse(`${wall(at, zone)}Z`) - Math.floor(at / 1000) * 1000;

/** An instant on the clock of a zone as `datetime-local` writes it: to the minute, or to the second where it counts. */
export function wallClock(instant, zone) {
  const at = Date.parse(instant);
  return Number.isNaN(at) ? '' : wall(at, zone).replace(/:00$/, '');
}

/**
 * The instants at which the clock of a zone shows a time: one; two where it is set back over it, the earlier first;
 * none where it is set forward over it.
 */
export function instantsOf(text, zone) {
  const utc = Date.parse(`${text}Z`);
  if (Number.isNaN(utc)) return [];
  const offsets = [...new Set([ahead(utc - DAY_MS, zone), ahead(utc + DAY_MS, zone)])];
  return offsets
    .filter(offset => ahead(utc - offset, zone) === offset)
    .map(offset => utc - offset)
    .sort((one, other) => one - other)
    .map(at => new Date(at).toISOString().replace('.000Z', 'Z'));
}

/** `UTC+2`, what a zone keeps at an instant. */
export function offsetName(instant, zone) {
  const minutes = ahead(Date.parse(instant), zone) / 60_000;
  const rest = Math.abs(minutes % 60);
  return `UTC${minutes < 0 ? '−' : '+'}${Math.floor(Math.abs(minutes) / 60)}${rest ? `:${String(rest).padStart(2, '0')}` : ''}`;
}

/** The instant, in seconds, at which a day begins on the clock of a zone, which is not midnight where that never comes. */
export function midnight(date, zone = 'UTC') {
  const utc = Date.parse(`${date}T00:00:00Z`);
  const [first] = instantsOf(`${date}T00:00`, zone);
  return (first ? Date.parse(first) : utc - ahead(utc - DAY_MS, zone)) / 1000;
}

/** The names of all zones that the browser knows, UTC first. */
export const zoneNames = () => ['UTC', ...(Intl.supportedValuesOf?.('timeZone') ?? []).filter(zone => zone !== 'UTC')];
