// A small line chart of numbers over numbers, such as the error over the evaluations of a search.
import { html, useRef } from '../html.js';
import { number } from '../format.js';
import { useWidth, ticks, logTicks, scale } from './axes.js';

const MARGIN = { left: 52, right: 12, top: 8, bottom: 34 };

/**
 * Lines: `{label, colour, dash, open, points: [[x, y], …]}`, with a dot at the end unless `open`; y may be logarithmic.
 * `range` fixes what y shows, `across` what x shows, `at` the marks of x, `zero` draws that line; `band` shades between `[x, low, high]`;
 * `peaks` are named places of x, `dots` places `[x, y]` that a text nearby is about.
 */
export function Curve({ lines, xLabel, yLabel, height = 200, log = false, range, across, at, zero = false, band = [], peaks = [], dots = [], label }) {
  const host = useRef(null);
  const width = useWidth(host) || 600;
  const drawn = lines.map(line => ({ ...line, points: line.points.filter(([, y]) => Number.isFinite(y) && (!log || y > 0)) }));
  const all = drawn.flatMap(line => line.points);
  if (all.length === 0) return html`<div ref=${host} class="note">Nothing to draw yet.</div>`;
  const ys = all.map(([, y]) => y);
  const xs = all.map(([x]) => x);
  const pad = range ?? (log ? [Math.min(...ys) * 0.9, Math.max(...ys) * 1.1] : [Math.min(...ys), Math.max(...ys)]);
  const domain = across ?? [Math.min(...xs, 0), Math.max(...xs, 1)];
  const x = scale(domain, [MARGIN.left, width - MARGIN.right]);
  const y = scale(pad, [height - MARGIN.bottom, MARGIN.top], log);
  const powers = log ? logTicks(...pad) : [];
  const marks = powers.length > 1 ? powers : ticks(...pad, 4);
  return html`<div ref=${host}>
    ${drawn.some(line => line.label) && html`<div class="legend">${drawn.map(
      line => html`<span><svg width="24" height="10" aria-hidden="true"><line x1="0" x2="24" y1="5" y2="5"
      style=${{ stroke: `var(--${line.colour})`, strokeWidth: 2, strokeDasharray: line.dash ?? 'none' }} /></svg> ${line.label}</span>`,
    )}</div>`}
    <svg class="chart" role="img" aria-label=${label} width=${width} height=${height} viewBox=${`0 0 ${width} ${height}`}>
      ${band.length > 0 && html`<path style="fill:var(--grid)" d=${`M${[...band.map(([px, , high]) => [px, high]),
        ...band.toReversed().map(([px, low]) => [px, low])].map(([px, py]) => `${x(px).toFixed(1)},${y(py).toFixed(1)}`).join('L')}Z`} />`}
      ${marks.map(
        mark => html`<g><line class="grid-line" x1=${MARGIN.left} x2=${width - MARGIN.right} y1=${y(mark)} y2=${y(mark)} />
        <text class="quiet" x=${MARGIN.left - 6} y=${y(mark) + 4} text-anchor="end">${number(mark)}</text></g>`,
      )}
      ${zero && html`<line class="axis" x1=${MARGIN.left} x2=${width - MARGIN.right} y1=${y(0)} y2=${y(0)} />`}
      ${(at ?? ticks(...domain, Math.max(Math.floor(width / 130), 2))).map(mark =>
        html`<text class="quiet" x=${x(mark)} y=${height - 18} text-anchor="middle">${number(mark, 4)}</text>`)}
      <text class="quiet" x=${(width + MARGIN.left) / 2} y=${height - 4} text-anchor="middle">${xLabel}</text>
      <text class="quiet" x="4" y=${MARGIN.top + 2} dominant-baseline="hanging"
        transform=${`rotate(-90 4 ${MARGIN.top + 2}) translate(${-(height - MARGIN.bottom) / 2} 0)`} text-anchor="middle">${yLabel}</text>
      ${drawn.map(
        line =>
          line.points.length > 0 &&
          html`<g style=${{ stroke: `var(--${line.colour})`, fill: 'none' }}>
        <path stroke-width="2" stroke-linejoin="round" stroke-dasharray=${line.dash ?? null}
          d=${`M${line.points.map(([px, py]) => `${x(px).toFixed(1)},${y(py).toFixed(1)}`).join('L')}`} />
        ${!line.open && html`<circle cx=${x(line.points.at(-1)[0])} cy=${y(line.points.at(-1)[1])} r="3" style=${{ fill: `var(--${line.colour})` }} />`}</g>`,
      )}
      ${dots.map(([px, py]) => html`<circle cx=${x(px)} cy=${y(py)} r="4" style="fill:var(--ground);stroke:var(--text);stroke-width:1.5" />`)}
      ${peaks.map(
        (peak, row) => html`<g><line class="axis" stroke-dasharray="2 3" x1=${x(peak.x)} x2=${x(peak.x)} y1=${MARGIN.top} y2=${height - MARGIN.bottom} />
        <text class="haloed" x=${x(peak.x) + (x(peak.x) > width / 2 ? -4 : 4)} y=${MARGIN.top + 12 + 15 * row}
          text-anchor=${x(peak.x) > width / 2 ? 'end' : 'start'}>${peak.text}</text></g>`,
      )}
    </svg>
  </div>`;
}
