// Numbers between -1 and 1 of all pairs of names: blue below zero, orange above it, the ground's own colour at zero.
import { html, useId, useRef } from '../html.js';
import { useWidth, signedColour, SignedScale } from './axes.js';
import { signed } from '../format.js';

const LETTER_PX = 6.6;
const CELL_PX = [14, 30];
/** From here on a sign stands in the cell as well. */
const SIGNED = 0.7;

const signOf = (value, second) => (second !== undefined ? '▲' : Math.abs(value) < SIGNED ? '' : value < 0 ? '−' : '+');

/** `names` on both sides, `values` by row and column; `marked(row, column)` is a second number of the pairs that have one. */
export function Matrix({ names, values, marked, label }) {
  const host = useRef(null);
  const id = useId();
  const width = useWidth(host) || 600;
  const margin = Math.max(...names.map(name => name.length)) * LETTER_PX + 8;
  const cell = Math.min(Math.max((width - margin) / names.length, CELL_PX[0]), CELL_PX[1]);
  const side = margin + cell * names.length;
  const at = index => margin + index * cell;
  return html`<div ref=${host}>
    <div class="scroll" tabindex="0" role="region" aria-label=${label}>
    <svg class="chart" style="width:auto" role="img" aria-label=${label} width=${side} height=${side} viewBox=${`0 0 ${side} ${side}`}>
      ${names.map((name, index) => html`<g>
        <text x=${margin - 5} y=${at(index) + cell / 2 + 4} text-anchor="end">${name}</text>
        <text x="0" y="0" transform=${`translate(${at(index) + cell / 2 + 4} ${margin - 5}) rotate(-90)`}>${name}</text></g>`)}
      ${values.map((row, from) => row.map((value, to) => from !== to && html`<g>
        <rect x=${at(to)} y=${at(from)} width=${cell - 1} height=${cell - 1}
          style=${{ fill: signedColour(value, 1), stroke: 'var(--edge)', strokeWidth: 0.5 }}>
          <title>${`${names[from]} and ${names[to]}: ${signed(value, 3)}${marked(from, to) === undefined ? '' :
            `, by the data alone ${signed(marked(from, to), 3)}`}`}</title></rect>
        ${signOf(value, marked(from, to)) && html`<text class=${Math.abs(value) >= SIGNED ? 'sign' : 'sign pale'}
          x=${at(to) + cell / 2 - 0.5} y=${at(from) + cell / 2 + 3.5} text-anchor="middle">${signOf(value, marked(from, to))}</text>`}</g>`))}
    </svg></div>
    <p class="legend"><span>go against each other</span><span>−1 <${SignedScale} id=${id} /> +1</span><span>go with each other</span></p>
  </div>`;
}
