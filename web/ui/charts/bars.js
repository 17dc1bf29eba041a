// Bars up and down from zero: an autocorrelation, or heat by the hour of the day.
import { html, useRef } from '../html.js';
import { number } from '../format.js';
import { useWidth, ticks, scale } from './axes.js';

const MARGIN = { left: 52, right: 10, top: 8, bottom: 34 };

/** `values` from `first` on; `band` shades what chance alone would give. */
export function Bars({ values, first = 0, band, xLabel, yLabel, height = 180, label, signedColours = false, every = 6 }) {
  const host = useRef(null);
  const width = useWidth(host) || 500;
  const known = values.filter(value => value !== null);
  const most = Math.max(...known, band ?? 0, 1e-9);
  const least = Math.min(...known, -(band ?? 0), 0);
  const y = scale([least, most], [height - MARGIN.bottom, MARGIN.top]);
  const step = (width - MARGIN.left - MARGIN.right) / values.length;
  return html`<div ref=${host}><svg class="chart" role="img" aria-label=${label} width=${width} height=${height} viewBox=${`0 0 ${width} ${height}`}>
    ${band && html`<rect x=${MARGIN.left} width=${width - MARGIN.left - MARGIN.right} y=${y(band)} height=${y(-band) - y(band)}
      style="fill:var(--grid)" />`}
    ${ticks(least, most, 4).map(
      mark => html`<g><line class="grid-line" x1=${MARGIN.left} x2=${width - MARGIN.right} y1=${y(mark)} y2=${y(mark)} />
      <text class="quiet" x=${MARGIN.left - 6} y=${y(mark) + 4} text-anchor="end">${number(mark)}</text></g>`,
    )}
    ${values.map(
      (value, index) =>
        value !== null &&
        html`<rect x=${MARGIN.left + index * step + step * 0.15} width=${Math.max(step * 0.7, 1)}
      y=${Math.min(y(value), y(0))} height=${Math.max(Math.abs(y(value) - y(0)), 0.5)}
        style=${{ fill: `var(--${signedColours && value > 0 ? 'heldout' : 'model'})` }}>
      <title>${`${xLabel} ${first + index}: ${number(value, 4)}`}</title></rect>`,
    )}
    <line class="axis" x1=${MARGIN.left} x2=${width - MARGIN.right} y1=${y(0)} y2=${y(0)} />
    ${values.map((_, index) => (index + first) % every === 0 &&
      html`<text class="quiet" x=${MARGIN.left + (index + 0.5) * step} y=${height - 18} text-anchor="middle">${first + index}</text>`)}
    <text class="quiet" x=${(width + MARGIN.left) / 2} y=${height - 4} text-anchor="middle">${xLabel}</text>
    <text class="quiet" x="4" y=${height / 2} transform=${`rotate(-90 10 ${height / 2})`} text-anchor="middle">${yLabel}</text>
  </svg></div>`;
}
