// What is shown is in the address: it can be sent to somebody, and the browser's way back works.
import { useState, useEffect } from './html.js';
import { REPORT } from './carried.js';

// A file on the disk has no paths below it, but everything behind `#` is its own.
const BASE = REPORT ? '#' : '/ui';
const listeners = new Set();

/** Where we are: the parts of the path below `/ui/`, and the query. */
export function here() {
  const [path, search] = (REPORT ? location.hash : location.pathname + location.search).slice(BASE.length).split('?');
  return { parts: path.split('/').filter(Boolean).map(decodeURIComponent), query: Object.fromEntries(new URLSearchParams(search)) };
}

/** The address of a page. */
export function address(parts, query = {}) {
  const kept = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== '');
  const path = `${BASE}/${parts.map(encodeURIComponent).join('/')}`;
  return kept.length ? `${path}?${new URLSearchParams(kept)}` : path;
}

/** The address of a system's tab. */
export const systemAddress = (system, tab, query) =>
  address(['systems', ...system.split('/'), ...(tab && tab !== 'fit' ? [tab] : [])], query);

export function go(to, { replace = false } = {}) {
  if (replace) history.replaceState(null, '', to);
  else history.pushState(null, '', to);
  listeners.forEach(listener => listener());
}

/** Keeps something with this step of the history, for whoever comes back to it. */
export const keepPlace = place => history.replaceState({ ...history.state, place }, '', location.href);

/** What was kept with it. */
export const keptPlace = () => history.state?.place ?? null;

/** Changes parts of the query and leaves the others; a null takes one away. */
export function setQuery(changes, { replace = true } = {}) {
  const { parts, query } = here();
  go(address(parts, { ...query, ...changes }), { replace });
}

export function useHere() {
  const [place, setPlace] = useState(here);
  useEffect(() => {
    const listener = () => setPlace(here());
    listeners.add(listener);
    addEventListener('popstate', listener);
    return () => {
      listeners.delete(listener);
      removeEventListener('popstate', listener);
    };
  }, []);
  return place;
}

// Links inside the page do not load it anew; with a modifier they stay what they are.
document.addEventListener('click', event => {
  const link = event.target.closest?.('a[href]');
  if (!link || event.defaultPrevented || event.button !== 0 || event.metaKey || event.ctrlKey || event.shiftKey || event.altKey) return;
  const url = new URL(link.href);
  if (url.origin !== location.origin || !url.pathname.startsWith(`${BASE}/`) || link.hasAttribute('download') || url.hash) return;
  event.preventDefault();
  go(url.pathname + url.search);
});
