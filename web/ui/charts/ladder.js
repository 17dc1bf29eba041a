// The error ladder: one column per model, and how far the error falls from one to the next.
import { html, useRef } from '../html.js';
import { number, fixed } from '../format.js';
import { useWidth, ticks, scale } from './axes.js';

const MARGIN = { left: 52, right: 16, top: 14, bottom: 44 };
const HEIGHT = 260;
const SERIES = [
  ['train', 'train_rmse', 'measured', '2 3'],
  ['validation', 'validation_rmse', 'model', ''],
  ['test (never used)', 'test_rmse', 'heldout', '6 4'],
];

const MARKS = {
  train: (x, y) => html`<circle cx=${x} cy=${y} r="5" />`,
  validation: (x, y) => html`<path d=${`M${x},${y - 7}L${x + 7},${y}L${x},${y + 7}L${x - 7},${y}Z`} />`,
  'test (never used)': (x, y) => html`<path d=${`M${x},${y - 7}L${x + 6.5},${y + 5}L${x - 6.5},${y + 5}Z`} />`,
};

/** Steps: `{label, train_rmse, validation_rmse, test_rmse, kept}`; `floor` is drawn across, with its name. */
export function LadderChart({ steps, floor, floorName = 'noise floor', unit, label }) {
  const host = useRef(null);
  const width = useWidth(host) || 700;
  const values = steps.flatMap(step => SERIES.map(([, key]) => step[key])).filter(Number.isFinite);
  const y = scale([0, Math.max(...values, floor ?? 0) * 1.08 || 1], [HEIGHT - MARGIN.bottom, MARGIN.top]);
  const x = at => MARGIN.left + ((at + 0.5) * (width - MARGIN.left - MARGIN.right)) / steps.length;
  // Train falls while validation rises: what was learnt does not repeat.
  const overfit = at =>
    at > 0 && steps[at].train_rmse < steps[at - 1].train_rmse && steps[at].validation_rmse > steps[at - 1].validation_rmse * 1.005;
  return html`<div ref=${host}>
    <div class="legend">${SERIES.map(
      ([
        name,
        ,
        tone,
        dash,
      ]) => html`<span><svg width="30" height="14" aria-hidden="true" style=${{ fill: `var(--${tone})`, stroke: `var(--${tone})` }}>
      <line x1="0" x2="30" y1="7" y2="7" stroke-dasharray=${dash || null} />${MARKS[name](15, 7)}</svg> ${name}</span>`,
    )}
      ${floor && html`<span><svg width="24" height="10" aria-hidden="true"><line x1="0" x2="24" y1="5" y2="5"
        style="stroke:var(--quiet);stroke-dasharray:1 3;stroke-width:2" /></svg> ${floorName}</span>`}</div>
    <svg class="chart ladder" role="img" aria-label=${label} width=${width} height=${HEIGHT} viewBox=${`0 0 ${width} ${HEIGHT}`}>
      <defs><pattern id="overfit" width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)"><line x1="0" y1="0"
        x2="0" y2="6" style="stroke:var(--bad);stroke-width:2;opacity:.5" /></pattern></defs>
      ${ticks(0, Math.max(...values, floor ?? 0) * 1.08 || 1, 5).map(
        mark => html`<g><line class="grid-line" x1=${MARGIN.left} x2=${width - MARGIN.right} y1=${y(mark)} y2=${y(mark)} />
        <text class="quiet" x=${MARGIN.left - 6} y=${y(mark) + 4} text-anchor="end">${number(mark)}</text></g>`,
      )}
      ${steps.map(
        (_, at) =>
          overfit(at) &&
          html`<g><rect x=${x(at - 1)} width=${x(at) - x(at - 1)} y=${MARGIN.top} height=${HEIGHT - MARGIN.top - MARGIN.bottom}
            fill="url(#overfit)" />
        <text x=${(x(at - 1) + x(at)) / 2} y=${MARGIN.top + 12} text-anchor="middle" style="fill:var(--bad);font-weight:600">overfit</text></g>`,
      )}
      ${floor && html`<line x1=${MARGIN.left} x2=${width - MARGIN.right} y1=${y(floor)} y2=${y(floor)}
        style="stroke:var(--quiet);stroke-dasharray:1 3;stroke-width:2" />`}
      ${SERIES.map(([name, key, tone, dash]) => {
        const points = steps.map((step, at) => [x(at), step[key], step.kept]).filter(([, value]) => Number.isFinite(value));
        return html`<g style=${{ stroke: `var(--${tone})`, fill: `var(--${tone})` }}>
          <path fill="none" stroke-width="1.5" stroke-dasharray=${dash || null}
            d=${points.length ? `M${points.map(([px, value]) => `${px},${y(value)}`).join('L')}` : ''} />
          ${points.map(([px, value, kept]) =>
            html`<g style=${kept === false ? 'opacity:.45' : ''}>${MARKS[name](px, y(value))}<title>${`${name}: ${number(value, 4)} ${unit}`}
              </title></g>`)}
        </g>`;
      })}
      ${steps.map(
        (step, at) => html`<g><text x=${x(at)} y=${HEIGHT - 26} text-anchor="middle" style="font-weight:600">${step.label}</text>
        <text class="quiet" x=${x(at)} y=${HEIGHT - 11} text-anchor="middle">
          ${step.kept === false ? '✕ not kept' : Number.isFinite(step.validation_rmse) ? `${fixed(step.validation_rmse)} ${unit}` : ''}</text></g>`,
      )}
    </svg>
  </div>`;
}
