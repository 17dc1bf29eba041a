// Keys, and the list of them that `?` shows. None fires inside a field, and none with a modifier.
import { useLayoutEffect, useRef } from './html.js';

const active = new Set();
let prefix = null;
let timer = null;

const typing = target => target.closest?.('input, textarea, select, [contenteditable], dialog[open]');

/** Keys that charts hear only where they have the focus; they are listed with the others. */
export const CHART_KEYS = [
  ['← →', 'pan the chart that has the focus'],
  ['+ −', 'zoom it in or out'],
  ['z', 'show the whole range again'],
];

document.addEventListener('keydown', event => {
  if (event.defaultPrevented || event.metaKey || event.ctrlKey || event.altKey || typing(event.target)) return;
  const key = prefix ? `${prefix} ${event.key}` : event.key;
  clearTimeout(timer);
  prefix = null;
  const maps = [...active].reverse();
  for (const keys of maps) {
    const entry = keys.current[key];
    if (entry) {
      event.preventDefault();
      entry[1]();
      return;
    }
  }
  if (maps.some(keys => Object.keys(keys.current).some(name => name.startsWith(`${event.key} `)))) {
    prefix = event.key;
    timer = setTimeout(() => {
      prefix = null;
    }, 1000);
  }
});

/** Binds keys while a component is there: `{'g o': ['what it does', () => …]}`. */
export function useKeys(keys) {
  const latest = useRef(keys);
  latest.current = keys;
  // What is drawn hears its keys at once: a key that somebody is quick with is not lost.
  useLayoutEffect(() => {
    active.add(latest);
    return () => active.delete(latest);
  }, []);
}

/** Everything that can be done now: `{key, meaning, act}`. */
export function actionsNow() {
  const seen = new Map();
  for (const keys of active) for (const [key, [meaning, act]] of Object.entries(keys.current)) seen.set(key, { key, meaning, act });
  return [...seen.values()].filter(({ meaning }) => meaning);
}
