// The token that the service wants where there are any. It lives as long as the tab, and leaves it in a header only.
const KEY = 'lampyris-token';
const listeners = new Set();
let waiting = [];
/** What the dialog asks: `{token, problem}`, the token that was refused and why; null where nothing is asked. */
let question = null;
/** The token for which the dialog was left, and when. Nobody is asked twice who did not try again. */
let left = null;
let held = null;

/** The token, or null. */
export function token() {
  try {
    return sessionStorage.getItem(KEY);
  } catch {
    // Storage may be switched off: then it lives as long as the page.
    return held;
  }
}

export const tokenQuestion = () => question;

/** Calls `listener` when a question comes up or is settled. */
export function onTokenQuestion(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

function ask(next) {
  question = next;
  listeners.forEach(listener => listener());
}

/** Takes a token, or null to forget it; whatever was refused is tried again. */
export function setToken(text) {
  held = text;
  try {
    if (text === null) sessionStorage.removeItem(KEY);
    else sessionStorage.setItem(KEY, text);
  } catch {
    /* it is held above */
  }
  left = null;
  const hopeful = waiting;
  waiting = [];
  ask(null);
  hopeful.forEach(({ resolve }) => resolve());
}

/** Leaves the question: what was refused stays so, apart from streams, which wait on. */
export function leaveToken() {
  if (!question) return;
  const { problem } = question;
  left = { token: question.token, at: performance.now() };
  const refused = waiting.filter(({ patient }) => !patient);
  waiting = waiting.filter(({ patient }) => patient);
  ask(null);
  refused.forEach(({ reject }) => reject(problem));
}

/**
 * Waits for another token than one that was refused, with a request that was sent at that time of `performance`. All
 * who wait ask one question. After it was left, it must not be brought back by an answer that was then on its way, nor
 * by those who come again by themselves, which are `patient`.
 */
export function anotherToken(refused, problem, { sent, patient }) {
  if (token() !== refused) return Promise.resolve();
  if (!question) {
    const known = left !== null && left.token === refused;
    if (known && !patient && sent <= left.at) return Promise.reject(problem);
    if (!(known && patient)) ask({ token: refused, problem });
  }
  return new Promise((resolve, reject) => waiting.push({ resolve, reject, patient }));
}
