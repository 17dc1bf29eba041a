// What the small charts share: their width on the screen, round numbers on an axis, and the colours of signed values.
import { html, useState, useLayoutEffect } from '../html.js';

/** The width of an element in pixels, as it changes. */
export function useWidth(element) {
  const [width, setWidth] = useState(0);
  useLayoutEffect(() => {
    const observer = new ResizeObserver(([entry]) => setWidth(Math.floor(entry.contentRect.width)));
    observer.observe(element.current);
    setWidth(Math.floor(element.current.clientWidth));
    return () => observer.disconnect();
  }, []);
  return width;
}

/** Round numbers between two, about `count` of them. */
export function ticks(low, high, count = 5) {
  const span = high - low || Math.abs(high) || 1;
  const raw = span / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(factor => factor * power).find(size => size >= raw);
  const first = Math.ceil(low / step) * step;
  const marks = [];
  for (let mark = first; mark <= high + step * 1e-9; mark += step) marks.push(Math.abs(mark) < step * 1e-9 ? 0 : mark);
  return marks;
}

/** Powers of ten between two, with 2 and 5 where there are few. */
export function logTicks(low, high) {
  const marks = [];
  const factors = Math.log10(high / low) > 2.5 ? [1] : [1, 2, 5];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power += 1) {
    for (const factor of factors) marks.push(factor * 10 ** power);
  }
  return marks.filter(mark => mark >= low && mark <= high);
}

/** From values to pixels. */
export function scale([low, high], [from, to], log = false) {
  const at = log ? Math.log : value => value;
  const span = at(high) - at(low) || 1;
  return value => from + ((at(value) - at(low)) / span) * (to - from);
}

/** A colour of signed values: blue below zero and orange above it, and at zero the ground on which it lies, light or dark. */
export const signedColour = (value, most) =>
  `color-mix(in srgb, var(--${value < 0 ? 'model' : 'heldout'}) ${Math.round(Math.min(Math.abs(value) / most, 1) * 100)}%, var(--ground))`;

/** The scale of these colours, from `-most` to `most`; `id` names its gradient. */
export const SignedScale = ({ id }) => html`<svg width="160" height="10" aria-hidden="true">
  <defs><linearGradient id=${id}>${['model', 'ground', 'heldout'].map((end, at) =>
    html`<stop offset=${at / 2} style=${{ stopColor: `var(--${end})` }} />`)}</linearGradient></defs>
  <rect width="160" height="10" fill=${`url(#${id})`} style="stroke:var(--edge)" /></svg>`;
