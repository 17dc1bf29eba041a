// Parameters by what people call them, with the symbol of the equations beside it.
import { html } from '../html.js';
import { ask, useResource } from '../api.js';
import { REPORT } from '../carried.js';
import { titleFor } from '../format.js';

/** The title of a parameter as a document has it: `heat exchange, floor to room air`. */
export const titleOf = ({ quantity, title }) => [quantity, title].filter(Boolean).join(', ');

/**
 * All that the documents of a model say of its parameters, by symbol; a family has the symbol before its brackets. What is
 * compiled without a system lacks the parameters that only some channels bring, so the base is read as well, where there is
 * one: what a report carries is compiled with its channels.
 */
async function parametersOf(path, options) {
  const model = await ask(path, options);
  const base = model.document?.base && !REPORT ? await ask(`/models/${encodeURIComponent(model.document.base)}`, options) : model;
  const written = Object.entries((base.expanded ?? base.document)?.parameters ?? {});
  return Object.fromEntries([
    ...written.map(([key, { scale, ...entry }]) => [key.split('[')[0], { scale, title: titleOf(entry) }]),
    ...model.parameters.map(({ name, scale, title }) => [name, { scale, title }]),
  ]);
}

/** Titles and scales of a model's parameters; none as long as they are not known, or for no model. */
export function useParameters(model) {
  const { data } = useResource(model ? `/models/${encodeURIComponent(model)}` : null, { read: parametersOf });
  const known = data ?? {};
  const titles = Object.fromEntries(Object.entries(known).map(([symbol, { title }]) => [symbol, title]));
  return { titles, scaleOf: symbol => (known[symbol] ?? known[symbol.split('[')[0]])?.scale };
}

export const useTitles = model => useParameters(model).titles;

export function Parameter({ symbol, titles }) {
  const title = titleFor(symbol, titles);
  return title ? html`${title} <code class="symbol">${symbol}</code>` : html`<code>${symbol}</code>`;
}
