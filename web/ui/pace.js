// Lists are read anew while many jobs end one after another, but not for each of them.
import { useEffect, useRef } from './html.js';

/** What comes together, as the ends of a batch do, counts once. */
const SOON_MS = 250;
const BYTES_PER_MS = 10;
/** What an answer brings beside its body. */
const HEAD_BYTES = 500;

/**
 * Gives a function that has a resource read anew: soon where it has not been for long, otherwise as late as keeps it below
 * 10 kB a second, which as many `lists` share, if it brings as much as it did last. `again(true)` has it read soon in any
 * case.
 */
export function usePaced(resource, lists = 1) {
  const latest = useRef(resource);
  latest.current = resource;
  const state = useRef({ timer: null, due: Infinity, free: -Infinity });
  useEffect(() => () => clearTimeout(state.current.timer), []);
  return (atOnce = false) => {
    const now = Date.now();
    const due = Math.max(now + SOON_MS, atOnce ? 0 : state.current.free);
    if (due >= state.current.due) return;
    clearTimeout(state.current.timer);
    const read = () => {
      const bytes = HEAD_BYTES + JSON.stringify(latest.current.data).length;
      state.current = { timer: null, due: Infinity, free: Date.now() + (bytes * lists) / BYTES_PER_MS };
      latest.current.reload();
    };
    state.current = { ...state.current, timer: setTimeout(read, due - now), due };
  };
}
