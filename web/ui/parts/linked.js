// Systems by name, with commas between them and the way to each.
import { html } from '../html.js';
import { systemAddress } from '../router.js';

/** `to` says where the link of a system leads. */
export const Linked = ({ systems, to = systemAddress }) =>
  systems.map((system, at) => html`${at > 0 ? ', ' : ''}<a class="nowrap" href=${to(system)}>${system}</a>`);
