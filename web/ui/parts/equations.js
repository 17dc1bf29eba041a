// The equations of a model: as the texts of its documents, with what an effect adds marked, and typeset.
import { html, useLayoutEffect, useRef, useState } from '../html.js';
import { ask, useResource } from '../api.js';
import { REPORT } from '../carried.js';
import { sayFault } from '../say.js';
import { copy } from './frame.js';

/** A model with more states or equations has more lines than anybody wants to see unasked. */
const MOST_STATES = 20;

/** The terms of a catalogue's effect for its argument: `metered_gain:P_heater` fills `{channel}` in. */
function termsOf(document, argument) {
  const constants = document.choices?.[argument] ?? {};
  const filled = text =>
    Object.entries(constants).reduce(
      (words, [name, value]) => words.replaceAll(`{${name}}`, value),
      text.replaceAll('{channel}', argument ?? ''),
    );
  return [...Object.entries(document.terms ?? {}), ...Object.entries(document.outputs ?? {})].map(([place, text]) => [
    filled(place),
    filled(text),
  ]);
}

/** What a model is built on: its own document, or that of its base. A plant says its layout; its equations are what that comes to. */
export async function baseOf(model, options) {
  const whole = model.document.base ? await ask(`/models/${encodeURIComponent(model.document.base)}`, options) : model;
  return whole.expanded ?? whole.document;
}

/** Lines `{left, terms}` of a model: its own equations, or those of its base, and what each of its effects adds. */
async function linesOf(path, options) {
  const model = await ask(path, options);
  const base = await baseOf(model, options);
  const lines = new Map();
  const add = (place, term) => lines.set(place, [...(lines.get(place) ?? []), term]);
  for (const [state, text] of Object.entries(base.equations ?? {})) add(state, text);
  for (const [output, entry] of Object.entries(base.outputs ?? {})) add(output, entry.expr);
  for (const name of model.effects) {
    const [id, argument] = name.split(/:(.*)/);
    const document = await ask(`/effects/${encodeURIComponent(id)}`, options).catch(() => ({}));
    for (const [place, text] of termsOf(document, argument)) add(place, text);
  }
  const states = model.states.map(state => state.name);
  return [...lines].map(([place, terms]) => ({ left: states.includes(place) ? `d${place}/dt` : place, place, terms }));
}

/** The text of a definition; one with variants has the first that the channels allow. */
const definition = entry =>
  Array.isArray(entry)
    ? entry
        .map(variant => `${variant.expr}${variant.needs?.length ? ` where ${variant.needs.join(' and ')} is measured` : ''}`)
        .join(', or ')
    : entry;

/** `diff`: what an effect adds, as a model with a parent names it. */
export function Equations({ model, diff = {} }) {
  const added = { ...diff.terms, ...diff.outputs };
  const lines = useResource(`/models/${encodeURIComponent(model)}`, { read: linesOf });
  if (!lines.data) return html`<div class="equation quiet">${lines.error ? lines.error.detail : '…'}</div>`;
  const known = lines.data.map(line => line.place);
  const fresh = Object.entries(added).filter(([place]) => !known.includes(place));
  const text = html`<div class="equation">
    ${lines.data.map(line => html`<div>${line.left} = ${line.terms.join(' + ')}${added[line.place] ?
      html`<ins>+ ${added[line.place]}</ins>` : ''}</div>`)}
    ${fresh.map(([place, term]) => html`<ins>d${place}/dt = ${term}</ins>`)}
    ${Object.entries(diff.define ?? {}).map(([name, entry]) => html`<ins>${name} = ${definition(entry)}</ins>`)}
  </div>`;
  return known.length > MOST_STATES ? html`<details class="typeset"><summary>${known.length} equations</summary>${text}</details>` : text;
}

const asText = (path, options) => ask(path, { ...options, accept: 'text/plain' });

/**
 * The equations as mathematics, which the browser draws by itself. `path` answers with them in the format it is asked
 * for; `states` is how many there are.
 */
export function Typeset({ path, states }) {
  const [open, setOpen] = useState(states <= MOST_STATES);
  const place = useRef(null);
  const drawn = useResource(open && !REPORT ? `${path}?format=mathml` : null, { read: asText });
  useLayoutEffect(() => {
    if (!drawn.data) return;
    const { documentElement } = new DOMParser().parseFromString(drawn.data, 'application/xml');
    place.current.replaceChildren(document.importNode(documentElement, true));
  }, [drawn.data]);
  if (REPORT) return null;
  const latex = () => asText(`${path}?format=latex`).then(copy, sayFault);
  return html`<details class="typeset" open=${open} onToggle=${event => setOpen(event.currentTarget.open)}>
    <summary>As mathematics</summary>
    <div class="formula" role="region" aria-label="The equations as mathematics" tabindex="0" ref=${place}></div>
    ${drawn.error && html`<p class="note">${drawn.error.detail}</p>`}
    <button class="plain" onClick=${latex}>Copy LaTeX</button>
  </details>`;
}
