// Points with their intervals over what should explain them, and the straight line through all.
import { html, useRef } from '../html.js';
import { number } from '../format.js';
import { useWidth, ticks, scale } from './axes.js';

const MARGIN = { left: 52, right: 16, top: 8, bottom: 34 };

/** `points`: `{x, y, low, high, title}`; `line`: `{slope, intercept}`. The dashed line is where y equals x. */
export function Scatter({ points, line, xLabel, yLabel, height = 260, label }) {
  const host = useRef(null);
  const width = useWidth(host) || 500;
  const xs = points.map(point => point.x);
  const across = [Math.min(...xs, 0), Math.max(...xs, 0)];
  const ys = [...points.flatMap(point => [point.y, point.low ?? point.y, point.high ?? point.y]), ...across, 0];
  const up = [Math.min(...ys), Math.max(...ys)];
  const pad = ([low, high]) => [low - (high - low) * 0.04, high + (high - low) * 0.04];
  const x = scale(pad(across), [MARGIN.left, width - MARGIN.right]);
  const y = scale(pad(up), [height - MARGIN.bottom, MARGIN.top]);
  const at = value => line.slope * value + line.intercept;
  const sample = dash => html`<svg width="24" height="10" aria-hidden="true"><line x1="0" x2="24" y1="5" y2="5"
    style=${{ stroke: `var(--${dash ? 'strong-edge' : 'model'})`, strokeWidth: 2, strokeDasharray: dash ?? 'none' }} /></svg>`;
  return html`<div ref=${host}>
    <div class="legend"><span>${sample()} ${`straight line through all samples, slope ${number(line.slope, 2)}`}</span><span>${sample('4 4')} slope 1</span></div>
    <svg class="chart" role="img" aria-label=${label} width=${width} height=${height} viewBox=${`0 0 ${width} ${height}`}>
      ${ticks(...up, 4).map(
        mark => html`<g><line class="grid-line" x1=${MARGIN.left} x2=${width - MARGIN.right} y1=${y(mark)} y2=${y(mark)} />
        <text class="quiet" x=${MARGIN.left - 6} y=${y(mark) + 4} text-anchor="end">${number(mark)}</text></g>`,
      )}
      ${ticks(...across, Math.max(Math.floor(width / 110), 2)).map(
        mark => html`<g><line class="grid-line" x1=${x(mark)} x2=${x(mark)} y1=${MARGIN.top} y2=${height - MARGIN.bottom} />
        <text class="quiet" x=${x(mark)} y=${height - 18} text-anchor="middle">${number(mark)}</text></g>`,
      )}
      <line class="axis" x1=${MARGIN.left} x2=${width - MARGIN.right} y1=${y(0)} y2=${y(0)} />
      <line class="axis" x1=${x(0)} x2=${x(0)} y1=${MARGIN.top} y2=${height - MARGIN.bottom} />
      <line class="axis" stroke-width="2" stroke-dasharray="4 4" x1=${x(across[0])} y1=${y(across[0])} x2=${x(across[1])} y2=${y(across[1])} />
      <g style=${{ stroke: 'var(--model)' }}><line stroke-width="2" x1=${x(across[0])} y1=${y(at(across[0]))} x2=${x(across[1])}
        y2=${y(at(across[1]))} /></g>
      <g style=${{ stroke: 'var(--measured)', fill: 'var(--measured)' }}>${points.map(
        point => html`<g><title>${point.title}</title>
        ${point.low !== null && html`<line stroke-width="1.5" x1=${x(point.x)} x2=${x(point.x)} y1=${y(point.low)} y2=${y(point.high)} />`}
        <circle cx=${x(point.x)} cy=${y(point.y)} r="3.5" /></g>`,
      )}</g>
      <text class="quiet" x=${(width + MARGIN.left) / 2} y=${height - 4} text-anchor="middle">${xLabel}</text>
      <text class="quiet" x="4" y=${height / 2} transform=${`rotate(-90 10 ${height / 2})`} text-anchor="middle">${yLabel}</text>
    </svg>
  </div>`;
}
