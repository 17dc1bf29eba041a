// What happens to jobs, pushed by the service. One stream serves the whole page; a job that is watched has its own,
// because that one tells its story from the start.
import { useState, useEffect, useRef } from './html.js';
import { ask, send, AGAIN } from './api.js';

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

/** Reads server-sent events as the standard says: an id counts also where it comes without data. */
async function readEvents(body, place, hear) {
  const reader = body.getReader();
  const decoder = new TextDecoder();
  let text = '';
  let event = { kind: '', data: [] };
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    text += decoder.decode(value, { stream: true });
    const lines = text.split(/\r?\n/);
    text = lines.pop();
    for (const line of lines) {
      const [, field, content] = /^([^:]*):? ?(.*)$/.exec(line);
      if (line === '') {
        if (event.data.length && KINDS.includes(event.kind)) hear(event.kind, JSON.parse(event.data.join('\n')));
        event = { kind: '', data: [] };
      } else if (field === 'event') event.kind = content;
      else if (field === 'data') event.data.push(content);
      else if (field === 'id') place.last = content;
      else if (field === 'retry' && /^\d+$/.test(content)) place.pause = Number(content);
    }
  }
}

/**
 * Listens to a stream until `close` is called, comes back after a break and says what it heard last. The browser's own
 * EventSource does the same, but can show no token.
 */
function listen(path, hear, standing = () => {}) {
  const abort = new AbortController();
  const { signal } = abort;
  const place = { last: '', pause: AGAIN_MS };
  const go = async () => {
    while (!signal.aborted) {
      try {
        const headers = { accept: 'text/event-stream', ...(place.last && { 'last-event-id': place.last }) };
        const response = await send(path, { headers, signal, patient: true });
        // The end was told already.
        if (response.status === 204) return;
        if (response.ok) {
          standing(true);
          await readEvents(response.body, place, (kind, data) => signal.aborted || hear(kind, data));
        }
      } catch {
        // A break looks the same wherever it comes from; after `close` nobody listens any more.
      }
      if (signal.aborted) return;
      standing(false);
      await new Promise(done => setTimeout(done, place.pause));
    }
  };
  go();
  return () => abort.abort();
}

/** Starts the stream of the whole page, once. */
export function start() {
  listen('/events', (kind, data) => listeners.forEach(listener => listener(kind, data)), setConnected);
}

/** Calls `hear(kind, data)` for every event until the function that it gives is called. */
export function onEvents(hear) {
  listeners.add(hear);
  return () => listeners.delete(hear);
}

/** Calls `hear(kind, data)` for every event; `data` is a job, or says which `job` it is about. */
export function useEvents(hear) {
  const latest = useRef(hear);
  latest.current = hear;
  useEffect(() => onEvents((kind, data) => latest.current(kind, data)), []);
}

/** Reads resources anew when a job of a system has ended; null is no system. */
export function useAfterJobs(system, ...resources) {
  useEvents((kind, data) => kind === 'finished' && data.system === system && resources.forEach(resource => resource.reload()));
}

/** Whether the stream stands: null before it first did. */
export function useConnection() {
  const [standing, setStanding] = useState(connected);
  useEffect(() => {
    connectionListeners.add(setStanding);
    // It may have come to stand since this was drawn.
    setStanding(connected);
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
            if (kind === 'progress') return { ...before, reports: [...before.reports, { ...data, at: Date.now() }] };
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
