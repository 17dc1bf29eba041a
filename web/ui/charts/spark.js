// The last few errors of a system, the newest to the right.
import { html } from '../html.js';
import { number } from '../format.js';

const [WIDTH, HEIGHT] = [84, 22];

export function Spark({ values, unit }) {
  const most = Math.max(...values);
  const step = WIDTH / Math.max(values.length, 6);
  return html`<svg class="chart" style="width:84px" viewBox=${`0 0 ${WIDTH} ${HEIGHT}`} role="img"
    aria-label=${`Errors of the last ${values.length} fits: ${values.map(value => number(value)).join(', ')} ${unit}`}>
    ${values.map(
      (
        value,
        at,
      ) => html`<rect x=${at * step} width=${Math.max(step - 2, 2)} y=${HEIGHT - Math.max((value / most) * (HEIGHT - 2), 2)}
        height=${Math.max((value / most) * (HEIGHT - 2), 2)}
      style=${{ fill: `var(--${at === values.length - 1 ? 'model' : 'strong-edge'})` }} />`,
    )}
  </svg>`;
}
