// Numbers in rows. Columns: `[title, 'number'?]`, the title a text; cells: text, numbers as text, or elements; `title` says
// more than the caption. Rows that come and go have `keys`, so that the focus stays with its own.
import { html } from '../html.js';
import { explained } from './term.js';

/** From as many columns on, a row is a card where the window is narrow. */
const CARDS = 3;

/**
 * A cell that says its column, for where the head of the table is not to be seen. The roles are said because a card is no
 * table row to the browser.
 */
function Cell({ title, kind, first, children }) {
  return first
    ? html`<th scope="row" role="rowheader" class=${kind} data-label=${title}>${children}</th>`
    : html`<td role="cell" class=${kind} data-label=${title}>${children}</td>`;
}

export function Table({ caption, title = caption, columns, rows, keys = [], hidden = false, cards = columns.length >= CARDS }) {
  const kind = index => (columns[index]?.[1] === 'number' ? 'number' : undefined);
  return html`<div class="scroll" tabindex="0" role="region" aria-label=${caption}>
    <table role="table" class=${cards ? 'cards' : ''}>
      <caption role="caption" class=${hidden ? 'unseen' : ''}>${hidden ? title : explained(title)}</caption>
      <thead role="rowgroup"><tr role="row">${columns.map(([title], index) =>
        html`<th scope="col" role="columnheader" class=${kind(index)}>${explained(title)}</th>`)}</tr></thead>
      <tbody role="rowgroup">${rows.map(
        (row, at) =>
          html`<tr role="row" key=${keys[at]}>${row.map((cell, index) =>
            html`<${Cell} title=${columns[index]?.[0]} kind=${kind(index)} first=${index === 0}>${cell}</${Cell}>`,
          )}</tr>`,
      )}</tbody>
    </table>
  </div>`;
}
