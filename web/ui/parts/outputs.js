// The outputs of a model: which of several is looked at is part of the address.
import { html } from '../html.js';
import { number } from '../format.js';
import { setQuery } from '../router.js';

/** What a model without a filter does not do. */
export const NO_FORECASTS =
  'This model has no filter that could follow the measurements, so it makes no forecasts: its errors are those of free runs.';

/** All outputs at once, as the address says it. */
const ALL = 'all';

/** Whether a fit forecasts at all; `metrics` are those of its outputs, and what is not known yet does. */
export const forecasts = metrics => Object.keys(metrics).length === 0 || Object.values(metrics).some(({ noise_floor: floor }) => floor !== null);

/** The output that fails most: its free run errs by the largest multiple of the noise that is left in it. Null where there is none. */
export const worstOutput = metrics =>
  Object.keys(metrics).reduce((worst, name) => (worst === null || (metrics[name].rho ?? 0) > (metrics[worst].rho ?? 0) ? name : worst), null);

/** The output that is looked at: the one that the address names, else the worst; null where `all` may be seen and are asked for. */
export function outputIn(query, metrics, all = false) {
  if (all && query.output === ALL) return null;
  return Object.hasOwn(metrics, query.output ?? '') ? query.output : worstOutput(metrics);
}

/** The address with the next output, and after the last one with all where these can be shown. */
export function nextOutput(query, metrics, all) {
  const list = [...Object.keys(metrics), ...(all ? [null] : [])];
  setQuery({ output: list[(list.indexOf(outputIn(query, metrics, all)) + 1) % list.length] ?? ALL });
}

/** A button for each output, nothing where there is one. `all` shows all at once where that is asked for. */
export function Outputs({ metrics, query, all = false }) {
  const outputs = Object.keys(metrics);
  if (outputs.length < 2) return null;
  const shown = outputIn(query, metrics, all);
  const worst = worstOutput(metrics);
  return html`<span class="row"><span class="segments" role="group" aria-label="Output">${[...outputs, ...(all ? [null] : [])].map(
    name => html`<button aria-pressed=${name === shown} onClick=${() => setQuery({ output: name ?? ALL })}>${name ?? 'All outputs'}</button>`,
  )}</span>
    <span class="quiet">${worst} fails most: its error is ${number(metrics[worst].rho)} times its noise.</span></span>`;
}
