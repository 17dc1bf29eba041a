// What every window shows of one effect: a dot with its interval along time, zero, and what they show together.
import { html, useRef } from '../html.js';
import { number, day, seconds } from '../format.js';
import { useWidth, ticks, scale } from './axes.js';

const MARGIN = { left: 52, right: 12, top: 8, bottom: 20 };
const HEIGHT = 104;
/** Half of the width of a 95 % interval, in deviations. */
const Z95 = 1.96;

/** `windows`: `{from, to, size, deviation, pooled}`; `pooled`: `{size, ci95}` or null; `span`: the seconds that all strips share. */
export function Windows({ windows, pooled, span, unit, label }) {
  const host = useRef(null);
  const width = useWidth(host) || 460;
  const ends = windows.flatMap(({ size, deviation }) => [size - Z95 * deviation, size + Z95 * deviation]);
  const all = [...ends, 0, ...(pooled?.ci95 ?? [])];
  const up = [Math.min(...all), Math.max(...all)];
  const y = scale(up, [HEIGHT - MARGIN.bottom, MARGIN.top]);
  const x = scale(span, [MARGIN.left, width - MARGIN.right]);
  const across = { x1: MARGIN.left, x2: width - MARGIN.right };
  return html`<div ref=${host}><svg class="chart" role="img" aria-label=${label} width=${width} height=${HEIGHT} viewBox=${`0 0 ${width} ${HEIGHT}`}>
    ${ticks(...up, 3).map(
      mark => html`<g><line class="grid-line" ...${across} y1=${y(mark)} y2=${y(mark)} />
      <text class="quiet" x=${MARGIN.left - 6} y=${y(mark) + 4} text-anchor="end">${number(mark)}</text></g>`,
    )}
    ${
      pooled &&
      html`<g style="fill:var(--model);stroke:var(--model)"><rect x=${across.x1} width=${across.x2 - across.x1} y=${y(pooled.ci95[1])}
        height=${Math.max(y(pooled.ci95[0]) - y(pooled.ci95[1]), 1)} style="stroke:none;opacity:.18" />
      <line ...${across} y1=${y(pooled.size)} y2=${y(pooled.size)} stroke-dasharray="6 3" /></g>`
    }
    <line class="axis" ...${across} y1=${y(0)} y2=${y(0)} />
    ${windows.map(window => {
      const middle = x((seconds(window.from) + seconds(window.to)) / 2);
      const half = Z95 * window.deviation;
      return html`<g style=${{ stroke: `var(--${window.pooled ? 'measured' : 'strong-edge'})`, strokeWidth: 1.5 }}>
        <title>${`${day(window.from)} to ${day(window.to)}: ${number(window.size, 4)} ± ${number(half, 3)} ${unit}${window.pooled ? '' : ', not added up'}`}</title>
        <line x1=${middle} x2=${middle} y1=${y(window.size - half)} y2=${y(window.size + half)} />
        <circle cx=${middle} cy=${y(window.size)} r="3.5" style=${{ fill: window.pooled ? 'var(--measured)' : 'var(--ground)' }} /></g>`;
    })}
    <text class="quiet" x=${MARGIN.left} y=${HEIGHT - 4}>${day(span[0])}</text>
    <text class="quiet" x=${width - MARGIN.right} y=${HEIGHT - 4} text-anchor="end">${day(span[1])}</text>
  </svg></div>`;
}
