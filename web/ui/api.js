// The only way to the service. Every fault is a Problem with what the service said of it.
import { useState, useEffect, useRef } from './html.js';
import { REPORT } from './carried.js';
import { token, anotherToken } from './token.js';

/** A problem document (RFC 9457), or no answer at all (status 0). */
class Problem extends Error {
  constructor(status, document) {
    super(document.detail || document.title);
    this.status = status;
    this.title = document.title;
    this.detail = document.detail;
    this.type = document.type;
    this.errors = document.errors ?? [];
    this.document = document;
  }
}

async function problemOf(response) {
  const text = await response.text();
  try {
    return new Problem(response.status, JSON.parse(text));
  } catch {
    return new Problem(response.status, { title: `The service answered ${response.status}`, detail: text.slice(0, 300) });
  }
}

/** The answer that a report carries. It has every line as a whole, so that a range and a number of points mean nothing. */
function carried(path) {
  const [place, query] = path.split('?');
  const asked = new URLSearchParams(query);
  for (const name of ['from', 'to', 'max_points']) asked.delete(name);
  const known = decodeURIComponent(place);
  const answer = REPORT.answers[String(asked) ? `${known}?${asked}` : known];
  if (answer === undefined) throw new Problem(404, { title: 'This is not in the report', detail: 'These measurements do not allow it, or only a service can compute it.' });
  return answer;
}

/**
 * Sends a request with the token, if there is one, and asks for another one where it is refused. `patient` is for
 * those who come again by themselves. Any other answer is for the caller to judge.
 */
export async function send(path, { headers = {}, patient = false, ...options } = {}) {
  for (;;) {
    const shown = token();
    const sent = performance.now();
    let response;
    try {
      response = await fetch(path, { ...options, headers: shown === null ? headers : { ...headers, authorization: `Bearer ${shown}` } });
    } catch (error) {
      if (error.name === 'AbortError') throw error;
      throw new Problem(0, { title: 'No answer from the service', detail: 'It may be restarting, or the connection is lost.' });
    }
    if (response.status !== 401) return response;
    try {
      await anotherToken(shown, await problemOf(response), { sent, patient });
    } catch (problem) {
      // Whoever has gone meanwhile does not want to know.
      options.signal?.throwIfAborted();
      throw problem;
    }
  }
}

/** The tags of the documents that were answered with one. */
const tags = new WeakMap();

/**
 * Asks the service; JSON back, or text for `accept: 'text/csv'`. `body` may be an object, or `csv` a text. A change
 * goes through where the place is as it is expected: `seen` is the document that was answered, `isNew` says that there
 * is none. Otherwise the answer is the problem `not-as-expected`.
 */
export async function ask(path, { method = 'GET', body, csv, accept = 'application/json', signal, seen, isNew = false } = {}) {
  if (REPORT) return carried(path);
  const headers = { accept };
  if (seen) headers['if-match'] = tags.get(seen);
  if (isNew) headers['if-none-match'] = '*';
  if (body !== undefined) headers['content-type'] = 'application/json';
  if (csv !== undefined) headers['content-type'] = 'text/csv';
  const response = await send(path, { method, headers, signal, body: csv ?? (body === undefined ? undefined : JSON.stringify(body)) });
  if (!response.ok) throw await problemOf(response);
  if (response.status === 204) return null;
  if (accept !== 'application/json') return response.text();
  const answer = await response.json();
  const tag = response.headers.get('etag');
  if (tag !== null) tags.set(answer, tag);
  return answer;
}

export const post = (path, body) => ask(path, { method: 'POST', body });
export const put = (path, body, expected) => ask(path, { method: 'PUT', body, ...expected });
export const remove = path => ask(path, { method: 'DELETE' });

/** Writes the document of a system, where it still is as it was seen. */
export const putSystem = (seen, { system, ...body }) => put(`/systems/${system}`, body, { seen });

/** As many items of a list are asked for at once as the service gives. */
const PAGE_SIZE = 500;
/** Of a list that grows with time the newest come first, and nobody looks at more of them. */
const MOST = 1000;

/** Asks for a list page by page; `take` hears each of them, and ends it with `false`. */
export async function eachPage(path, take, options) {
  let token = null;
  do {
    const page = await ask(withQuery(path, { page_size: PAGE_SIZE, page_token: token }), options);
    if (take(page) === false) return;
    token = page.next_page_token;
  } while (token);
}

/** All items of a list, or the first of them. */
export async function every(path, { most = Infinity, ...options } = {}) {
  const items = [];
  const take = page => {
    items.push(...page.items);
    return items.length < most;
  };
  await eachPage(path, take, options);
  return items;
}

/** The window hears this when the service is there again after a break: then everything is read anew. */
export const AGAIN = 'lampyris-again';

const asItIs = (path, options) => ask(path, options);

/**
 * What is at a path: `{data, error, loading, reload, replace}`. What was there stays while it is asked again, so that a
 * chart keeps its zoom; `null` asks for nothing. `replace` takes what a change was answered with.
 */
export function useResource(path, { read = asItIs } = {}) {
  const [state, setState] = useState({ path: null, data: null, error: null, loading: path !== null });
  const [turn, setTurn] = useState(0);
  useEffect(() => {
    const again = () => setTurn(before => before + 1);
    addEventListener(AGAIN, again);
    return () => removeEventListener(AGAIN, again);
  }, []);
  const reading = useRef(read);
  reading.current = read;
  useEffect(() => {
    if (path === null) {
      setState({ path, data: null, error: null, loading: false });
      return undefined;
    }
    const abort = new AbortController();
    setState(before => ({ ...before, loading: true }));
    reading.current(path, { signal: abort.signal }).then(
      data => setState({ path, data, error: null, loading: false }),
      error => error.name === 'AbortError' || setState(before => ({ ...before, path, data: null, error, loading: false })),
    );
    return () => abort.abort();
  }, [path, turn]);
  const reload = () => setTurn(before => before + 1);
  const replace = data => {
    setState(before => ({ ...before, data }));
    // An answer that is still on its way may be older.
    reload();
  };
  return { ...state, reload, replace };
}

const newest = (path, options) => every(path, { ...options, most: MOST });

/** The items of a list; the rows of all systems are `useSystems`. */
export const useList = path => useResource(path, { read: newest });

/** The command that asks the same; `file` is a CSV file that is sent. */
export function curl(path, { method, body, file, accept } = {}) {
  const quoted = text => `'${text.replaceAll("'", "'\\''")}'`;
  const words = ['curl -s'];
  if (token() !== null) words.push('-H "authorization: Bearer $LAMPYRIS_TOKEN"');
  if (method) words.push(`-X ${method}`);
  if (accept) words.push(`-H 'accept: ${accept}'`);
  if (body !== undefined) words.push(`-H 'content-type: application/json' -d ${quoted(JSON.stringify(body))}`);
  if (file !== undefined) words.push(`-H 'content-type: text/csv' --data-binary ${quoted(`@${file}`)}`);
  words.push(quoted(location.origin + path));
  return words.join(' ');
}

/** A path with a query; what is null or empty is left out. */
export function withQuery(path, query) {
  const pairs = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== '');
  return pairs.length ? `${path}${path.includes('?') ? '&' : '?'}${new URLSearchParams(pairs)}` : path;
}
