// The names of time zones, to choose from while one types.
import { html } from '../html.js';
import { zoneNames } from '../zones.js';

export const Zones = ({ id }) =>
  html`<datalist id=${id}>${zoneNames().map(zone => html`<option value=${zone} />`)}</datalist>`;
