// The outputs of a model: which of several is looked at is part of the address.
import { html } from '../html.js';
import { setQuery } from '../router.js';

/** What a model without a filter does not do. */
export const NO_FORECASTS =
  'This model has no filter that could follow the measurements, so it makes no forecasts: its errors are those of free runs.';

/** Whether a fit forecasts at all; `metrics` are those of its outputs, and what is not known yet does. */
export const forecasts = metrics => Object.keys(metrics).length === 0 || Object.values(metrics).some(({ noise_floor: floor }) => floor !== null);

/** The output that the address names; null where it names none that is there. */
export const outputIn = (query, outputs) => (outputs.includes(query.output) ? query.output : null);

/** The address with the next output, and after the last one with none where `all` can be shown. */
export function nextOutput(query, outputs, all) {
  const list = all ? [null, ...outputs] : outputs;
  const at = list.indexOf(outputIn(query, outputs) ?? list[0]);
  setQuery({ output: list[(at + 1) % list.length] });
}

/** A button for each output, nothing where there is one. `all` shows all at once where none is chosen, else it is the first. */
export function Outputs({ outputs, query, all = false }) {
  if (outputs.length < 2) return null;
  const shown = outputIn(query, outputs) ?? (all ? null : outputs[0]);
  return html`<span class="segments" role="group" aria-label="Output">${[...(all ? [null] : []), ...outputs].map(
    name => html`<button aria-pressed=${name === shown} onClick=${() => setQuery({ output: name })}>${name ?? 'All outputs'}</button>`,
  )}</span>`;
}
