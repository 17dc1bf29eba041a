// The token that the service wants where there are any. It lives as long as the tab, and leaves it in a header only.
const KEY = 'lampyris-token';
const listeners = new Set();
let waiting = [];
/** What the dialog asks: `{token, problem}`, the token that was refused and why; null where nothing is asked. */
let question = null;
/** The token for which the dialog was left. Nobody is asked twice who did not try again. */
let left;
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
  left = undefined;
  const hopeful = waiting;
  waiting = [];
  ask(null);
  hopeful.forEach(({ resolve }) => resolve());
}

/** Leaves the question: what was refused stays so, apart from streams, which wait on. */
export function leaveToken() {
  if (!question) return;
  const { problem } = question;
  left = question.token;
  const refused = waiting.filter(({ patient }) => !patient);
  waiting = waiting.filter(({ patient }) => patient);
  ask(null);
  refused.forEach(({ reject }) => reject(problem));
}

/**
 * Waits for another token than one that was refused. All who wait ask one question; `patient` is for those who come
 * again by themselves and must not bring it back after it was left.
 */
export function anotherToken(refused, problem, patient) {
  if (token() !== refused) return Promise.resolve();
  if (!question && !(patient && left === refused)) ask({ token: refused, problem });
  return new Promise((resolve, reject) => waiting.push({ resolve, reject, patient }));
}
