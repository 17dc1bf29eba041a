// What happens to jobs, pushed by the service. One stream serves the whole page; a job that is watched has its own,
// because that one tells its story from the start.
import { useState, useEffect, useRef } from './html.js';
import { ask, AGAIN } from './api.js';

const KINDS = ['queued', 'started', 'progress', 'incumbent', 'finished'];
const AGAIN_MS = 2000;
const listeners = new Set();
const connectionListeners = new Set();
let connected = null;

function setConnected(value) {
  if (connected === value) return;
  // What happened while nobody listened is read again from the lists.
  if (connected === false && value) dispatchEvent(new Event(AGAIN));
  connected = value;
  connectionListeners.forEach(listener => listener(value));
}

/**
 * Listens to a stream until `close` is called. The browser comes back by itself after a break and says what it heard
 * last; only after an answer that is no stream it gives up, so then it is opened anew.
 */
function listen(path, hear, standing = () => {}) {
  let source = null;
  let timer = null;
  const open = () => {
    source = new EventSource(path);
    source.onopen = () => standing(true);
    source.onerror = () => {
      standing(false);
      if (source.readyState === EventSource.CLOSED) timer = setTimeout(open, AGAIN_MS);
    };
    for (const kind of KINDS) source.addEventListener(kind, event => hear(kind, JSON.parse(event.data)));
  };
  open();
  return () => {
    clearTimeout(timer);
    source.close();
  };
}

/** Starts the stream of the whole page, once. */
export function start() {
  listen('/events', (kind, data) => listeners.forEach(listener => listener(kind, data)), setConnected);
}

/** Calls `hear(kind, data)` for every event; `data` is a job, or says which `job` it is about. */
export function useEvents(hear) {
  const latest = useRef(hear);
  latest.current = hear;
  useEffect(() => {
    const listener = (kind, data) => latest.current(kind, data);
    listeners.add(listener);
    return () => listeners.delete(listener);
  }, []);
}

/** Whether the stream stands: null before it first did. */
export function useConnection() {
  const [standing, setStanding] = useState(connected);
  useEffect(() => {
    connectionListeners.add(setStanding);
    return () => connectionListeners.delete(setStanding);
  }, []);
  return standing;
}

const ENDED = ['succeeded', 'failed', 'cancelled'];
export const hasEnded = job => ENDED.includes(job.state);

/** A job as it goes: the document, every report of its progress, its best parameters. */
export function useJob(id) {
  const [state, setState] = useState({ job: null, reports: [], incumbent: null, error: null });
  useEffect(() => {
    if (!id) return undefined;
    setState({ job: null, reports: [], incumbent: null, error: null });
    let close = () => {};
    let left = false;
    ask(`/jobs/${id}`).then(
      job => {
        if (left) return;
        setState(before => ({ ...before, job }));
        if (hasEnded(job)) return;
        close = listen(`/jobs/${id}/events`, (kind, data) => {
          setState(before => {
            if (kind === 'progress') return { ...before, reports: [...before.reports, data] };
            if (kind === 'incumbent') return { ...before, incumbent: data.parameters };
            return { ...before, job: data };
          });
          if (kind === 'finished') close();
        });
      },
      error => left || setState(before => ({ ...before, error })),
    );
    return () => {
      left = true;
      close();
    };
  }, [id]);
  return state;
}
