// Numbers in rows. Columns: `[title, 'number'?]`; cells: text, numbers as text, or elements; `title` says more than the caption.
import { html } from '../html.js';
import { explained } from './term.js';

export function Table({ caption, title = caption, columns, rows, hidden = false }) {
  const kind = index => (columns[index]?.[1] === 'number' ? 'number' : undefined);
  return html`<div class="scroll" tabindex="0" role="region" aria-label=${caption}>
    <table>
      <caption class=${hidden ? 'unseen' : ''}>${hidden ? title : explained(title)}</caption>
      <thead><tr>${columns.map(([title], index) => html`<th scope="col" class=${kind(index)}>${explained(title)}</th>`)}</tr></thead>
      <tbody>${rows.map(
        row =>
          html`<tr>${row.map((cell, index) =>
            index === 0 ? html`<th scope="row" class=${kind(index)}>${cell}</th>` : html`<td class=${kind(index)}>${cell}</td>`,
          )}</tr>`,
      )}</tbody>
    </table>
  </div>`;
}
