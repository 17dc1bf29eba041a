// The names of time zones, to choose from while one types.
import { html } from '../html.js';

export const Zones = ({ id }) =>
  html`<datalist id=${id}>${['UTC', ...Intl.supportedValuesOf('timeZone').filter(zone => zone !== 'UTC')].map(zone => html`<option value=${zone} />`)}</datalist>`;
