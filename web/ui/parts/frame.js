// What is around every chart: its sentence for those who do not see it, its numbers, and how to get them.
import { html, useState, useId, useRef } from '../html.js';
import { ask, curl } from '../api.js';
import { REPORT } from '../carried.js';
import { say, sayFault } from '../say.js';
import { picture } from './picture.js';
import { Table } from './table.js';
import { explained } from './term.js';

const SHOWN_ROWS = 300;

/** The chart that was used last. */
let last = null;

/** Shows or hides the numbers of the chart that has the focus, that was used last, or that comes first below the front. */
export function toggleTable() {
  const focused = document.activeElement?.closest('figure.frame');
  const figure = focused ?? (last?.isConnected ? last : document.querySelector('figure.frame:not(.front .frame)'));
  if (!figure) {
    say('There is no chart here');
    return;
  }
  figure.querySelector('.tools button').click();
  requestAnimationFrame(() => (figure.querySelector('.numbers') ?? figure).scrollIntoView({ block: 'nearest' }));
}

/** Has the browser keep something as a file of this name. */
export function save(blob, name) {
  const url = URL.createObjectURL(blob);
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
 * `csv` whether that path also speaks CSV, `everything()` gives the CSV of every sample where that is thinned;
 * `command` asks for the numbers where reading the path does not; `drawn` whether there is more to see than a table;
 * `about` says of a picture which output, range and error it shows.
 */
export function Frame({
  title, about = '', summary, table, path, command = path && curl(path), csv = false, everything = null, drawn = true, note, children,
}) {
  const [open, setOpen] = useState(null);
  const id = useId();
  const figure = useRef(null);
  const toggle = part => setOpen(open === part ? null : part);
  const used = () => {
    last = figure.current;
  };
  const download = (ending, make) => async () => {
    const name = `${title.toLowerCase().replaceAll(/[^a-z0-9]+/g, '-')}${ending}`;
    try {
      save(await make(), name);
      say(`${name} is saved`);
    } catch (error) {
      sayFault(error);
    }
  };
  const spreadsheet = async () =>
    new Blob([csv && !REPORT ? await ask(path, { accept: 'text/csv' }) : csvOf(table())], { type: 'text/csv' });
  const samples = async () => new Blob([await everything()], { type: 'text/csv' });
  const numbers = open === 'table' ? table() : null;
  return html`<figure class="frame" aria-labelledby=${id} ref=${figure} onFocusIn=${used} onPointerEnter=${used}>
    <figcaption>
      <h3 id=${id}>${explained(title)}</h3>
      <span class="tools">
        <button class="plain" aria-expanded=${open === 'table'} onClick=${() => toggle('table')}>Table</button>
        <button class="plain" onClick=${download(everything ? '-thinned.csv' : '.csv', spreadsheet)}>${everything ? 'CSV, thinned' : 'CSV'}</button>
        ${everything && html`<button class="plain" onClick=${download('-all-samples.csv', samples)}>CSV, all samples</button>`}
        ${drawn && html`<button class="plain" onClick=${download('.png', () => picture(figure.current, about))}>PNG</button>`}
        ${command && !REPORT && html`<button class="plain" aria-expanded=${open === 'curl'} onClick=${() => toggle('curl')}>curl</button>`}
      </span>
    </figcaption>
    ${summary && html`<p class="unseen">${summary}</p>`}
    ${open === 'curl' && html`<${Command} text=${command} />`}
    ${children}
    ${note && html`<p class="note">${note}</p>`}
    ${
      numbers &&
      html`<div class="numbers"><${Table} caption=${`${title}: numbers`} hidden cards=${false} columns=${numbers.columns}
        rows=${numbers.rows.slice(0, SHOWN_ROWS)} />
      ${numbers.rows.length > SHOWN_ROWS && html`<p class="note">The first ${SHOWN_ROWS} of ${numbers.rows.length} rows; CSV has all.</p>`}</div>`
    }
  </figure>`;
}

/** Puts a text where it can be pasted from, and says whether that went well. */
export const copy = async text => {
  try {
    await navigator.clipboard.writeText(text);
    say('Copied');
  } catch {
    say('This browser does not let the page copy', { fault: true });
  }
};

/** A command line that can be copied. */
export function Command({ text }) {
  return html`<div class="command"><code>${text}</code><button class="plain" onClick=${() => copy(text)}>Copy</button></div>`;
}
