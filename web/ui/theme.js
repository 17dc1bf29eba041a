// Light, dark, or what the system says. Charts on a canvas read their colours here.
import { useState, useEffect } from './html.js';

const KEY = 'lampyris-theme';
const dark = matchMedia('(prefers-color-scheme: dark)');
const listeners = new Set();

export const theme = () => document.documentElement.dataset.theme ?? 'system';

export function setTheme(value) {
  if (value === 'system') delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = value;
  try {
    if (value === 'system') localStorage.removeItem(KEY);
    else localStorage.setItem(KEY, value);
  } catch {
    /* it then holds for this page only */
  }
  listeners.forEach(listener => listener());
}

const scheme = () => (theme() === 'system' ? (dark.matches ? 'dark' : 'light') : theme());

/** `light` or `dark`; what draws on a canvas draws anew when it turns. */
export function useScheme() {
  const [now, setNow] = useState(scheme);
  useEffect(() => {
    const listener = () => setNow(scheme());
    listeners.add(listener);
    dark.addEventListener('change', listener);
    return () => {
      listeners.delete(listener);
      dark.removeEventListener('change', listener);
    };
  }, []);
  return now;
}

/** A colour of the style sheet by its name. */
export const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
