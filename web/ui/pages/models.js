// Models and effects: what the service knows, and the way to add to it.
import { html, useState } from '../html.js';
import { useList } from '../api.js';
import { address } from '../router.js';
import { Table } from '../parts/table.js';
import { Shown } from '../parts/screens.js';
import { general } from './model.js';

/** What is said of an effect that a diagnosis of other systems does not try yet. */
const ONE_ROOMS = 'Proposed for one system. From the third system on whose model has it, it is tried in all.';

export function Models() {
  const models = useList('/models');
  const effects = useList('/effects');
  const [wanted, setWanted] = useState('');
  const matches = entry => `${entry.id} ${entry.title} ${entry.explain ?? ''}`.toLowerCase().includes(wanted.toLowerCase());
  return html`
    <div class="row apart"><h1>Models and effects</h1>
      <span class="row"><input type="search" placeholder="Search" aria-label="Search models and effects" value=${wanted}
        onInput=${event => setWanted(event.target.value)} />
        <a class="button" href=${address(['edit', 'model'])}>Write a model</a><a class="button"
          href=${address(['edit', 'effect'])}>Describe an effect</a></span></div>
    <p>A model says how heat or matter moves; an effect adds a term to it. Both are documents that never change: a change is a new one.</p>
    <${Shown} of=${models} what="the models" show=${list => html`<${Table} caption="Models" columns=${[['model'], ['title'], ['made from']]}
      rows=${list.filter(matches).map(model => [html`<a href=${address(['models', model.id])}>${model.id}</a>`, model.title, model.parent ?
        html`<a href=${address(['models', model.parent])}>${model.parent}</a>` : ''])} />`} />
    <${Shown} of=${effects} what="the effects"
      show=${list => html`<${Table} caption="Effects" columns=${[['effect'], ['title'], ['what it says'], ['what its absence looks like'], ['in systems', 'number']]}
      rows=${list.filter(matches).map(effect => [html`<a href=${address(['effects', effect.id])}>${effect.id}</a>`, general(effect.title),
        general(effect.explain), effect.tried ? general(effect.signature) : ONE_ROOMS, String(effect.systems)])} />`} />`;
}
