// Lists are read anew while many jobs end one after another, but not for each of them.
import { useEffect, useRef } from './html.js';

/** What comes together, as the ends of a batch do, counts once. */
const SOON_MS = 250;
const BYTES_PER_MS = 10;

/**
 * `ask(bytes)` has `read` called: soon where it has not been for long, otherwise as late as keeps it below 10 kB a second
 * if it brings so many bytes. `ask(0)` has it called soon in any case.
 */
export function usePaced(read) {
  const latest = useRef(read);
  latest.current = read;
  const state = useRef({ timer: null, due: Infinity, last: -Infinity });
  useEffect(() => () => clearTimeout(state.current.timer), []);
  return bytes => {
    const now = Date.now();
    const due = Math.max(now + SOON_MS, state.current.last + bytes / BYTES_PER_MS);
    if (due >= state.current.due) return;
    clearTimeout(state.current.timer);
    const timer = setTimeout(() => {
      state.current = { timer: null, due: Infinity, last: Date.now() };
      latest.current();
    }, due - now);
    state.current = { ...state.current, timer, due };
  };
}
