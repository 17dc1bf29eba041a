// What is around every chart: its sentence for those who do not see it, its numbers, and how to get them.
import { html, useState, useId } from '../html.js';
import { ask, curl } from '../api.js';
import { say, sayFault } from '../say.js';
import { Table } from './table.js';

const SHOWN_ROWS = 300;

function save(text, name) {
  const url = URL.createObjectURL(new Blob([text], { type: 'text/csv' }));
  const link = document.createElement('a');
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

const cell = value => (/[",\n]/.test(String(value)) ? `"${String(value).replaceAll('"', '""')}"` : (value ?? ''));
const csvOf = ({ columns, rows }) => [columns.map(([title]) => title), ...rows].map(row => row.map(cell).join(',')).join('\n');

/**
 * A chart with its title. `table()` gives `{columns, rows}` of plain values; `path` is where the numbers came from,
 * `csv` whether that path also speaks CSV.
 */
export function Frame({ title, summary, table, path, csv = false, note, children }) {
  const [open, setOpen] = useState(null);
  const id = useId();
  const toggle = part => setOpen(open === part ? null : part);
  const name = `${title.toLowerCase().replaceAll(/[^a-z0-9]+/g, '-')}.csv`;
  const download = async () => {
    try {
      save(csv ? await ask(path, { accept: 'text/csv' }) : csvOf(table()), name);
      say(`${name} is saved`);
    } catch (error) {
      sayFault(error);
    }
  };
  const numbers = open === 'table' ? table() : null;
  return html`<figure class="frame" aria-labelledby=${id}>
    <figcaption>
      <h3 id=${id}>${title}</h3>
      <span class="tools">
        <button class="plain" aria-expanded=${open === 'table'} onClick=${() => toggle('table')}>Table</button>
        <button class="plain" onClick=${download}>CSV</button>
        ${path && html`<button class="plain" aria-expanded=${open === 'curl'} onClick=${() => toggle('curl')}>curl</button>`}
      </span>
    </figcaption>
    ${summary && html`<p class="unseen">${summary}</p>`}
    ${open === 'curl' && html`<${Command} text=${curl(path)} />`}
    ${children}
    ${note && html`<p class="note">${note}</p>`}
    ${
      numbers &&
      html`<div class="numbers"><${Table} caption=${`${title}: numbers`} hidden columns=${numbers.columns}
        rows=${numbers.rows.slice(0, SHOWN_ROWS)} />
      ${numbers.rows.length > SHOWN_ROWS && html`<p class="note">The first ${SHOWN_ROWS} of ${numbers.rows.length} rows; CSV has all.</p>`}</div>`
    }
  </figure>`;
}

/** A command line that can be copied. */
export function Command({ text }) {
  const copy = () =>
    navigator.clipboard.writeText(text).then(
      () => say('Copied'),
      () => say('This browser does not let the page copy', { fault: true }),
    );
  return html`<div class="command"><code>${text}</code><button class="plain" onClick=${copy}>Copy</button></div>`;
}
