// From which columns of a file the channels of a system come, and which systems are its neighbours.
import { html, useState } from '../html.js';
import { Table } from './table.js';

/** `channels` are columns by channel; `change` hears them anew. A row without a channel or a column binds nothing. */
export function Bindings({ channels, change }) {
  // Rows that are being written have no place in an object yet.
  const [draft, setDraft] = useState(null);
  const rows = draft ?? Object.entries(channels);
  const take = next => {
    setDraft(next);
    change(Object.fromEntries(next.filter(([channel, column]) => channel && column)));
  };
  const set = (at, row) => take(rows.map((entry, index) => (index === at ? row : entry)));
  return html`<${Table} caption="Channels and the columns that feed them" cards=${false} columns=${[['channel'], ['column'], ['']]} rows=${rows.map(
    ([channel, column], at) => [
      html`<input aria-label=${`Channel ${at + 1}`} value=${channel} placeholder="T_out" onInput=${event => set(at, [event.target.value.trim(), column])} />`,
      html`<input aria-label=${`Column of ${channel || `channel ${at + 1}`}`} value=${column} placeholder="Außentemperatur[degC]"
        onInput=${event => set(at, [channel, event.target.value])} />`,
      html`<button type="button" class="plain" aria-label=${`Leave out ${channel || 'the row'}`} onClick=${() => take(rows.filter((_, index) => index !== at))}>Leave out</button>`,
    ],
  )} />
    <p><button type="button" onClick=${() => setDraft([...rows, ['', '']])}>Bind another channel</button></p>`;
}

/** `neighbours` are systems next door; `known` those that can be added. */
export function NextDoor({ system, neighbours, known, change }) {
  const others = known.filter(name => name !== system && !neighbours.includes(name));
  return html`<p class="row">Neighbours: ${neighbours.length === 0 && 'none'} ${neighbours.map(
    name => html`<button type="button" class="plain" aria-label=${`Leave out the neighbour ${name}`}
      onClick=${() => change(neighbours.filter(other => other !== name))}>${name} ✕</button>`,
  )}
    <select aria-label="Add a neighbour" value="" onChange=${event => event.target.value && change([...neighbours, event.target.value])}>
      <option value="" selected>Add …</option>${others.map(name => html`<option value=${name}>${name}</option>`)}</select></p>`;
}
