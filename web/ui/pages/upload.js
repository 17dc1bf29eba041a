// Measurements from a file or the clipboard: which column is which channel, and in which unit.
import { html, useState, useRef } from '../html.js';
import { ask } from '../api.js';
import { say } from '../say.js';
import { clock } from '../format.js';
import { Table } from '../parts/table.js';
import { Failed } from '../parts/screens.js';

const PREVIEW_ROWS = 4;
const KNOWN = [
  'T_room',
  'T_out',
  'T_forward',
  'irradiance',
  'cloud_cover',
  'wind_speed',
  'wind_direction',
  'flow',
  'valve',
  'window_open',
  'occupancy',
  'CO2',
];
const UNITS = ['', 'degC', 'degF', 'K', 'W', 'kW', 'MW', 'W/m2', 'kW/m2', 'm/s', 'km/h', 'ppm', 'pct', 'deg', 'm3/h', 'm3/d', 'g/m3', '-'];
const TIME = /^(time|timestamp|date|datetime|date_time)$/i;

const separatorOf = header => [',', ';', '\t'].find(mark => header.includes(mark)) ?? ',';

/** The columns of a text with what their names say: `T_room[degC]` is the channel T_room in degC. */
export function columnsOf(text) {
  const lines = text.split(/\r?\n/).filter(line => line && !line.startsWith('#'));
  const mark = separatorOf(lines[0] ?? '');
  const cells = lines.slice(0, PREVIEW_ROWS + 1).map(line => line.split(mark).map(cell => cell.trim().replace(/^"(.*)"$/, '$1')));
  return (cells[0] ?? []).map((name, at) => {
    const [, channel, unit] = /^(.*?)\s*\[([^\]]*)\]$/.exec(name) ?? [null, name, ''];
    return { name, channel: TIME.test(name) ? 'time' : channel, unit, use: true, first: cells.slice(1).map(row => row[at] ?? '') };
  });
}

/** The same text with the header that the mapping says; columns that are left out go. */
export function mapped(text, columns) {
  const lines = text.split(/\r?\n/);
  const at = lines.findIndex(line => line && !line.startsWith('#'));
  const mark = separatorOf(lines[at]);
  const kept = columns.map((column, index) => [column, index]).filter(([column]) => column.use);
  const header = kept
    .map(([column]) => (column.channel === 'time' || !column.unit ? column.channel : `${column.channel}[${column.unit}]`))
    .join(mark);
  const rows = lines.slice(at + 1).map(line => {
    if (!line || line.startsWith('#') || kept.length === columns.length) return line;
    const cells = line.split(mark);
    return kept.map(([, index]) => cells[index] ?? '').join(mark);
  });
  return [...lines.slice(0, at), header, ...rows].join('\n');
}

export function Upload({ system, document, done, open }) {
  const [text, setText] = useState(null);
  const [columns, setColumns] = useState([]);
  const [answer, setAnswer] = useState(null);
  const [error, setError] = useState(null);
  const [over, setOver] = useState(false);
  const file = useRef(null);
  const take = content => {
    setText(content);
    setColumns(columnsOf(content));
    setAnswer(null);
    setError(null);
  };
  const read = files => files[0]?.text().then(take);
  const drop = event => {
    event.preventDefault();
    setOver(false);
    if (event.dataTransfer.files.length) read(event.dataTransfer.files);
    else take(event.dataTransfer.getData('text/plain'));
  };
  const change = (at, what) => setColumns(columns.map((column, index) => (index === at ? { ...column, ...what } : column)));
  const send = async () => {
    setError(null);
    try {
      const window_ = await ask(`/systems/${system}/windows`, { method: 'POST', csv: mapped(text, columns) });
      setAnswer(window_);
      setText(null);
      say(`${window_.rows} rows are taken`);
      done();
    } catch (fault) {
      setError(fault);
    }
  };
  const channels = [...new Set([...Object.keys(document.channels), ...Object.values(document.channels), ...KNOWN])];
  return html`<details class="card" open=${open || text !== null || answer !== null}><summary><b>Upload measurements</b></summary>
    ${
      text === null &&
      html`<div class="drop ${over ? 'over' : ''}" onDrop=${drop} onDragOver=${event => {
        event.preventDefault();
        setOver(true);
      }} onDragLeave=${() => setOver(false)}>
      <p>Drop a CSV file here, or <button onClick=${() => file.current.click()}>choose one</button></p>
      <input ref=${file} class="unseen" type="file" accept=".csv,text/csv" aria-label="CSV file" tabindex="-1"
        onChange=${event => read(event.target.files)} />
      <label>or paste its text<textarea rows="3" placeholder="time,T_room[degC],T_out[degC]" aria-label="CSV text" onPaste=${event => {
        event.preventDefault();
        take(event.clipboardData.getData('text/plain'));
      }}
        onChange=${event => event.target.value.trim() && take(event.target.value)}></textarea></label>
    </div>`
    }
    ${
      text !== null &&
      html`
      <datalist id="channels">${channels.map(name => html`<option value=${name} />`)}</datalist>
      <${Table} caption="Columns of the file" columns=${[['column'], ['use'], ['channel'], ['unit'], ['first values']]} rows=${columns.map(
        (column, at) => [
          column.name,
          html`<input type="checkbox" aria-label=${`Use ${column.name}`} checked=${column.use} disabled=${column.channel === 'time'}
            onChange=${event => change(at, { use: event.target.checked })} />`,
          html`<input list="channels" aria-label=${`Channel of ${column.name}`} value=${column.channel}
            onInput=${event => change(at, { channel: event.target.value })} />`,
          column.channel === 'time'
            ? 'RFC 3339'
            : html`<select aria-label=${`Unit of ${column.name}`} value=${column.unit} onChange=${event => change(at, { unit: event.target.value })}>
          ${[...new Set([...UNITS, column.unit])].map(unit =>
            html`<option value=${unit} selected=${unit === column.unit}>${unit || 'as its name says'}</option>`)}</select>`,
          column.first.join(', '),
        ],
      )} />
      ${error && html`<${Failed} error=${error} />`}
      <p class="row"><button class="main" onClick=${send}>Upload ${columns.filter(column => column.use).length - 1} channels</button><button
        onClick=${() => {
        setText(null);
        setError(null);
      }}>Leave it</button></p>`
    }
    ${
      answer &&
      html`<div class="outcome"><p class="says">${answer.rows} rows from ${clock(answer.from)} to ${clock(answer.to)} are taken as ${answer.id}.</p>
      ${answer.rejected_rows.length > 0 &&
        html`<p>▲ ${answer.rejected_rows.length} rows were refused:</p><ul>
          ${answer.rejected_rows.slice(0, 50).map(row => html`<li>line ${row.line}: ${row.reason}</li>`)}</ul>`}
      ${answer.warnings.map(warning => html`<p>▲ ${warning}</p>`)}</div>`
    }
  </details>`;
}
