// A value between its bounds, with its interval. A value at a bound is marked by a shape, a word and a colour.
import { html } from '../html.js';
import { number } from '../format.js';

const WIDTH = 200;

export function Rail({ value, interval, bounds: [low, high], log = false, atBound = false }) {
  const logged = log && low > 0;
  const at = logged ? Math.log : size => size;
  const place = size =>
    8 + (WIDTH - 16) * Math.min(Math.max((at(logged ? Math.max(size, low) : size) - at(low)) / (at(high) - at(low) || 1), 0), 1);
  const tone = atBound ? 'bad' : 'model';
  return html`<svg class="rail chart" width=${WIDTH} height="22" viewBox=${`0 0 ${WIDTH} 22`} role="img"
    aria-label=${`${number(value)} between ${number(low)} and ${number(high)}${atBound ? ', at bound' : ''}${logged ? ', logarithmic' : ''}`}>
    <line class="axis" x1="8" x2=${WIDTH - 8} y1="11" y2="11" />
    <line class="axis" x1="8" x2="8" y1="4" y2="18" stroke-width="2" /><line class="axis" x1=${WIDTH - 8} x2=${WIDTH - 8} y1="4" y2="18"
      stroke-width="2" />
    ${interval && html`<line x1=${place(interval[0])} x2=${place(interval[1])} y1="11" y2="11"
      style=${{ stroke: `var(--${tone})`, strokeWidth: 5, opacity: 0.45 }} />`}
    ${
      atBound
        ? html`<rect x=${place(value) - 5} y="6" width="10" height="10" style="fill:var(--bad)" />`
        : html`<circle cx=${place(value)} cy="11" r="5" style="fill:var(--model)" />`
    }
  </svg>`;
}
