// The error by hour and day: blue where less is measured than the model says, orange where it is more.
import { html, useId, useRef } from '../html.js';
import { number, reading, decimalsOfAll } from '../format.js';
import { useWidth, signedColour, SignedScale } from './axes.js';

const MARGIN = { left: 40, top: 4, bottom: 24 };
const ROW_PX = 11;
/** Few days do not make broad bars of the hours. */
const WIDEST_PX = 90;

/** `days`: `{date, hours: [24]}`. `onPick(date)` where a cell is clicked or a day is chosen. */
export function Heatmap({ days, unit, onPick, label }) {
  const host = useRef(null);
  const id = useId();
  const width = useWidth(host) || 600;
  const known = days.flatMap(day => day.hours).filter(value => value !== null);
  const decimals = decimalsOfAll(known, unit);
  const sizes = known.map(Math.abs).sort((a, b) => a - b);
  // The scale ends at the 98th percentile, so that one bad hour does not bleach the rest.
  const most = sizes.length ? Math.max(sizes[Math.floor(sizes.length * 0.98)], 1e-6) : 1;
  const cell = Math.min((width - MARGIN.left) / Math.max(days.length, 1), WIDEST_PX);
  const [less, more] = unit === 'K' ? ['colder', 'warmer'] : ['lower', 'higher'];
  const height = MARGIN.top + 24 * ROW_PX + MARGIN.bottom;
  const every = Math.max(Math.ceil(days.length / Math.max(Math.floor(width / 70), 1)), 1);
  const missing = sizes.length < 24 * days.length;
  const hatch = `${id}-none`;
  const chosen = event => event.target.value && days.some(day => day.date === event.target.value) && onPick(event.target.value);
  const pick = event => {
    const { day } = event.target.dataset;
    if (day !== undefined) onPick(days[Number(day)].date);
  };
  return html`<div ref=${host}>
    <svg class="chart heat" role="img" aria-label=${label} width=${width} height=${height} viewBox=${`0 0 ${width} ${height}`} onClick=${pick}>
      ${missing && html`<defs><${Hatch} id=${hatch} /></defs>`}
      ${days.map((day, at) =>
        day.hours.map(
          (value, hour) => html`<rect class="cell" data-day=${at}
        x=${MARGIN.left + at * cell} y=${MARGIN.top + hour * ROW_PX} width=${Math.max(cell - 0.5, 0.5)} height=${ROW_PX - 0.5}
          style=${{ fill: value === null ? `url(#${hatch})` : signedColour(value, most) }}>
        <title>${`${day.date} ${String(hour).padStart(2, '0')} h: ${value === null ? 'nothing to compare' : `${reading(value, decimals)} ${unit}`}`}</title></rect>`,
        ),
      )}
      <rect x=${MARGIN.left} y=${MARGIN.top} width=${cell * days.length} height=${24 * ROW_PX} style="fill:none;stroke:var(--edge)" />
      ${[0, 6, 12, 18].map(hour => html`<text class="quiet" x=${MARGIN.left - 5} y=${MARGIN.top + hour * ROW_PX + 9} text-anchor="end">
        ${String(hour).padStart(2, '0')} h</text>`)}
      ${days.map((day, at) => at % every === 0 && html`<text class="quiet" x=${MARGIN.left + at * cell} y=${height - 8}>${day.date.slice(5)}</text>`)}
    </svg>
    <p class="legend"><span>${less} than the model says</span><span>−${number(most, 2)} ${unit} <${SignedScale} id=${id} /> +${number(most, 2)} ${unit}</span>
      <span>${more}</span>
      ${missing && html`<span><svg width="24" height="10" aria-hidden="true"><defs><${Hatch} id=${`${hatch}-sample`} /></defs>
        <rect width="24" height="10" style=${{ fill: `url(#${hatch}-sample)` }} /></svg> nothing to compare</span>`}</p>
    <label class="inline">Click an hour to see its day in the chart, or choose a day <input type="date" min=${days[0]?.date} max=${days.at(-1)?.date} onChange=${chosen} /></label>
  </div>`;
}

/** What has no value is no zero. */
const Hatch = ({ id }) => html`<pattern id=${id} width="5" height="5" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">
  <line x1="0" y1="0" x2="0" y2="5" style="stroke:var(--strong-edge);stroke-width:1;opacity:.6" /></pattern>`;
