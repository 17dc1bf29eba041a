// Tells screen readers, and shows for a moment, what has happened.
const listeners = new Set();

export function say(text, { fault = false } = {}) {
  document.getElementById('said').textContent = text;
  listeners.forEach(listener => listener({ text, fault }));
}

/** Says why something did not work. */
export const sayFault = error =>
  say([error.title, error.detail, ...(error.errors ?? []).map(fault => fault.detail)].filter(Boolean).join('. '), { fault: true });

export function onSaid(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}
