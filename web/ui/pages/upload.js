// Measurements from a file or the clipboard: which column is which channel, and in which unit. What is confirmed is kept
// in the settings of the system, for the next file.
import { html, useState } from '../html.js';
import { ask, putSystem, withQuery } from '../api.js';
import { say } from '../say.js';
import { clock } from '../format.js';
import { Columns, Drop, HowRead, Rejected, bindingsOf, isPlain, saidOf, useReading } from '../parts/reading.js';
import { NotSaved } from '../parts/screens.js';

/** Rejected rows with their reasons, as the answer lists them, by reason. */
function byReason(rows) {
  const reasons = new Map();
  for (const { line, reason } of rows) {
    const known = reasons.get(reason) ?? { reason, count: 0, line };
    reasons.set(reason, { ...known, count: known.count + 1 });
  }
  return [...reasons.values()];
}

export function Upload({ system, document, done, changed, open }) {
  const reading = useReading(document.location?.zone ?? null, document.channels);
  const [answer, setAnswer] = useState(null);
  const [error, setError] = useState(null);
  const { body, data, columns, leave } = reading;
  const used = columns.filter(({ use }) => use);
  const take = content => {
    setAnswer(null);
    setError(null);
    reading.take(content);
  };
  const send = async () => {
    setError(null);
    try {
      const plain = isPlain(columns);
      if (!plain) {
        const channels = { ...document.channels, ...bindingsOf(columns) };
        if (JSON.stringify(channels) !== JSON.stringify(document.channels))
          changed(await putSystem(document, { ...document, channels }));
      }
      const path = withQuery(`/systems/${system}/windows`, saidOf(reading, plain ? null : 'bound'));
      const taken = await ask(path, { method: 'POST', csv: body });
      setAnswer(taken);
      leave();
      say(`${taken.rows} rows are taken`);
      done();
    } catch (fault) {
      setError(fault);
    }
  };
  const again = () =>
    ask(`/systems/${system}`).then(now => {
      changed(now);
      setError(null);
    }, setError);
  const channels = [...new Set([...Object.keys(document.channels), ...Object.values(document.channels)])];
  return html`<details class="card" open=${open || body !== null || answer !== null}><summary><b>Upload measurements</b></summary>
    ${body === null && html`<${Drop} take=${take} />`}
    <${HowRead} of=${reading} />
    ${body !== null && data && html`<${Columns} of=${reading} channels=${channels} />`}
    ${error && html`<${NotSaved} error=${error} again=${again}><p>Somebody has changed ${system} since this was read. Look at it, and upload once
      more.</p></${NotSaved}>`}
    ${body !== null && html`<p class="row">${data && html`<button class="main" disabled=${used.length === 0} onClick=${send}>Upload ${used.length} ${
      used.length === 1 ? 'channel' : 'channels'}</button>`}<button onClick=${() => {
      leave();
      setError(null);
    }}>Leave it</button></p>`}
    ${
      answer &&
      html`<div class="outcome"><p class="says">${answer.rows} rows from ${clock(answer.from)} to ${clock(answer.to)} are taken as ${answer.id}.</p>
      ${answer.rejected_rows.length > 0 && html`<${Rejected} reasons=${byReason(answer.rejected_rows)} />`}
      ${answer.warnings.map(warning => html`<p>▲ ${warning}</p>`)}</div>`
    }
  </details>`;
}
