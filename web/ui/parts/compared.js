// What a document says otherwise than the model that it was made from.
import { html } from '../html.js';
import { useResource } from '../api.js';
import { address } from '../router.js';
import { differences } from '../merge.js';
import { NONE } from '../format.js';
import { Failed, Loading } from './screens.js';
import { Table } from './table.js';

const shown = value => (value === undefined ? NONE : typeof value === 'string' ? value : JSON.stringify(value));

/** A document beside that of a model; one that names the model as its base is only what it adds. */
export function Compared({ with: id, written }) {
  const model = useResource(`/models/${encodeURIComponent(id)}`);
  if (model.error) return html`<${Failed} error=${model.error} retry=${model.reload} />`;
  if (!model.data) return html`<${Loading} what=${id} />`;
  const { title, effects, document } = model.data;
  const there = effects.length > 0 ? { title, base: document.base ?? document.id, effects } : document;
  // An id is new in any case.
  const found = differences(there, written).filter(([path]) => path !== 'id');
  const link = html`<a href=${address(['models', id])}>${id}</a>`;
  if (found.length === 0) return html`<p class="note">It says the same as ${link}, under another name.</p>`;
  return html`<p>${found.length} ${found.length === 1 ? 'field is' : 'fields are'} not as in ${link}:</p>
    <${Table} caption=${`Differences from ${id}`} hidden columns=${[['field'], [id], ['written here']]}
      rows=${found.map(([path, one, other]) => [path, html`<code>${shown(one)}</code>`, html`<code>${shown(other)}</code>`])} />`;
}
