// The measurements of a system: what is there, what was refused, and what is kept out of training.
import { html, useState, useMemo } from '../html.js';
import { useResource, useList, ask, putSystem, withQuery } from '../api.js';
import { setQuery } from '../router.js';
import { say, sayFault } from '../say.js';
import { number, clock, length, seconds, instant, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { When } from '../parts/when.js';
import { Shown, Empty, Failed, NotSaved } from '../parts/screens.js';
import { Strips } from '../charts/strips.js';
import { Upload } from './upload.js';

export function Data({ system, document, query, reload, changed }) {
  const windows = useList(`/systems/${system}/windows`);
  const path = withQuery(`/systems/${system}/series`, { max_points: 2000 });
  const series = useResource(windows.data?.length ? path : null);
  const zone = document.location?.zone ?? 'UTC';
  const done = () => {
    windows.reload();
    series.reload();
    reload();
  };
  return html`
    <${Upload} system=${system} document=${document} done=${done} changed=${changed} open=${windows.data?.length === 0} />
    <${Shown} of=${windows} what="the measurements"
      empty=${html`<${Empty} title="No measurements yet"><p>Upload a CSV file above; its first column is the time.</p></${Empty}>`}
      show=${list => html`
        ${series.error ? html`<${Failed} error=${series.error} retry=${series.reload} />` : series.data &&
          html`<${Series} all=${series.data} path=${path} query=${query} zone=${zone} />`}
        <${Exclusions} system=${system} document=${document} query=${query} zone=${zone} reload=${reload} changed=${changed} />
        <${Channels} list=${list} />
        <${Windows} list=${list} done=${done} />`} />`;
}

function Series({ all, path: wholePath, query, zone }) {
  const whole = useMemo(() => [seconds(all.from), seconds(all.to)], [all]);
  const range = query.from && query.to ? [seconds(query.from), seconds(query.to)] : null;
  // What is thinned is asked for anew where it is looked at closely, with as much again on both sides for moving on.
  const margin = range ? range[1] - range[0] : 0;
  const path =
    range && all.thinned
      ? withQuery(wholePath, { from: instant(Math.max(range[0] - margin, whole[0])), to: instant(Math.min(range[1] + margin, whole[1])) })
      : wholePath;
  const closer = useResource(path === wholePath ? null : path);
  const data = closer.data ?? all;
  const names = Object.keys(data.channels);
  const [time, strips] = useMemo(() => together(data), [data]);
  const thinned = Object.entries(data.channels).filter(([, channel]) => channel.bucket_s);
  const says = `${names.length} channels from ${clock(all.from, zone)} to ${clock(all.to, zone)}.`;
  return html`<${Frame} title="Measurements" path=${path} csv summary=${says}
    note=${thinned.length ? `Thinned: each point of ${thinned.map(([name]) =>
      name).join(', ')} stands for ${length(thinned[0][1].bucket_s)} and shows the lowest and the highest value.` : 'Every sample is shown.'}
    table=${() => ({
      columns: [['channel'], ['unit'], ['samples', 'number'], ['step'], ['gaps', 'number']],
      rows: names.map(name => {
        const channel = data.channels[name];
        return [name, channel.unit, channel.samples, length(channel.median_step_s), channel.gaps];
      }),
    })}>
    <${Coverage} data=${all} whole=${whole} />
    <${Strips} time=${time} strips=${strips} whole=${whole} range=${range} zone=${zone} label=${says}
      onZoom=${chosen => setQuery({ from: chosen && instant(chosen[0]), to: chosen && instant(chosen[1]) })} />
  </${Frame}>`;
}

/** All channels on one list of times: where a channel has no sample of its own, its line goes on; its gaps stay gaps. */
function together(data) {
  const tables = Object.values(data.channels).map(channel => {
    const times = channel.time.map(seconds);
    return channel.values ? [times, channel.values] : [times, channel.min, channel.max];
  });
  const [time, ...columns] = window.uPlot.join(tables);
  let at = 0;
  const strips = Object.entries(data.channels).map(([name, channel]) => {
    const line = channel.values ? { values: columns[at] } : { min: columns[at], max: columns[at + 1] };
    at += channel.values ? 1 : 2;
    return {
      label: name,
      unit: channel.unit,
      height: 64,
      lines: [{ label: name, colour: 'measured', width: 1.2, step: channel.hold === 'zero_order' && Boolean(channel.values), ...line }],
    };
  });
  return [time, strips];
}

/** The samples of a channel in per cent of those that its step asks for; 100 where none is missing. */
function completeness({ samples, median_step_s: step }, [first, last]) {
  const asked = step ? Math.round((last - first) / step) + 1 : 1;
  return Math.min(Math.floor((100 * samples) / asked), 100);
}

/** One row per channel: filled where there are samples. */
function Coverage({ data, whole }) {
  const cells = 240;
  const [first, last] = whole;
  const place = time => Math.min(Math.max(Math.floor(((time - first) / (last - first || 1)) * cells), 0), cells - 1);
  return html`<table><caption class="unseen">Coverage</caption><tbody>${Object.entries(data.channels).map(([name, channel]) => {
    const filled = new Set();
    const values = channel.values ?? channel.min;
    const reach = channel.bucket_s ?? channel.median_step_s;
    channel.time.forEach((time, at) => {
      if (values[at] === null) return;
      for (let cell = place(seconds(time) - reach / 2); cell <= place(seconds(time) + reach / 2); cell += 1) filled.add(cell);
    });
    const complete = completeness(channel, whole);
    return html`<tr><th scope="row" class="nowrap">${name}</th><td class="number nowrap">${complete} %</td>
      <td style="width:80%">
      <svg viewBox=${`0 0 ${cells} 8`} preserveAspectRatio="none" width="100%" height="12" role="img"
        aria-label=${`${name} has ${complete} % of its samples, ${channel.gaps} gaps`}>
        <rect width=${cells} height="8" style="fill:var(--grid)" />
          ${stretches(filled).map(([from, to]) => html`<rect x=${from} width=${to - from + 1} height="8" style="fill:var(--model)" />`)}
            </svg></td></tr>`;
  })}</tbody></table>`;
}

function stretches(filled) {
  const sorted = [...filled].sort((a, b) => a - b);
  const found = [];
  for (const cell of sorted) {
    const last = found.at(-1);
    if (last && last[1] === cell - 1) last[1] = cell;
    else found.push([cell, cell]);
  }
  return found;
}

/** Times that no fit may learn from, such as a holiday or a broken sensor. */
function Exclusions({ system, document, query, zone, reload, changed }) {
  const [draft, setDraft] = useState({ from: query.from ?? '', to: query.to ?? '', reason: '' });
  const [error, setError] = useState(null);
  const save = async exclude => {
    setError(null);
    try {
      changed(await putSystem(document, { ...document, exclude }));
      say('Exclusions are saved');
      return true;
    } catch (fault) {
      setError(fault);
      return false;
    }
  };
  const add = async event => {
    event.preventDefault();
    const isKept = await save([...document.exclude, { from: draft.from, to: draft.to, reason: draft.reason }]);
    if (isKept) setDraft({ from: '', to: '', reason: '' });
  };
  const again = () => {
    setError(null);
    reload();
  };
  const backwards = draft.from && draft.to && seconds(draft.from) > seconds(draft.to);
  return html`<section class="card"><h3>Kept out of training</h3>
    ${
      document.exclude.length === 0
        ? html`<p class="quiet">Nothing: every measurement is used.</p>`
        : html`<${Table} caption="Exclusions" hidden columns=${[[`from (${zone})`], ['to'], ['reason'], ['']]}
      rows=${document.exclude.map((entry, at) => [clock(entry.from, zone), clock(entry.to, zone), entry.reason,
        html`<button class="plain" onClick=${() => save(document.exclude.filter((_, other) => other !== at))}>Use it again</button>`])} />`
    }
    ${error && html`<${NotSaved} error=${error} again=${again}><p>Somebody has changed ${system} since this was read. What you wrote here
      stays.</p></${NotSaved}>`}
    <form class="row bottom" onSubmit=${add}>
      <${When} title="From" value=${draft.from} zone=${zone} change=${from => setDraft(now => ({ ...now, from }))} />
      <${When} title="To" value=${draft.to} zone=${zone} change=${to => setDraft(now => ({ ...now, to }))} />
      <label>Reason<input value=${draft.reason} required placeholder="windows were open"
        onInput=${event => setDraft({ ...draft, reason: event.target.value })} /></label>
      ${query.from && html`<button type="button"
        onClick=${() => setDraft({ ...draft, from: query.from, to: query.to })}>Take the shown range</button>`}
      <button disabled=${backwards}>Keep it out</button></form>
    ${backwards && html`<p role="status">▲ It ends before it begins.</p>`}
  </section>`;
}

function Channels({ list }) {
  const newest = list[0];
  return html`<${Table} caption=${`Channels of the newest upload, ${clock(newest.uploaded_at)}`}
    columns=${[['channel'], ['unit'], ['samples', 'number'], ['missing', 'number'], ['lowest', 'number'], ['highest', 'number'], ['step',
      'number'], ['longest gap', 'number'], ['longest stuck', 'number']]}
    rows=${Object.entries(newest.channels).map(([name, channel]) => [name, channel.unit, channel.samples, channel.missing,
      number(channel.min), number(channel.max), length(channel.median_step_s), length(channel.longest_gap_s), length(channel.stuck_s)])} />`;
}

function Windows({ list, done }) {
  const drop = window_ =>
    ask(`/windows/${window_.id}`, { method: 'DELETE' }).then(() => {
      say(`${window_.id} is deleted`);
      done();
    }, sayFault);
  return html`<${Table} caption="Uploads"
    columns=${[['window'], ['uploaded'], ['from'], ['to'], ['rows', 'number'], ['refused rows', 'number'], ['remarks'], ['']]}
    rows=${list.map(entry => [
      entry.id,
      clock(entry.uploaded_at),
      clock(entry.from),
      clock(entry.to),
      entry.rows,
      entry.rejected_rows.length
        ? html`<details><summary>${entry.rejected_rows.length}</summary><ul>
          ${entry.rejected_rows.map(row => html`<li>line ${row.line}: ${row.reason}</li>`)}</ul></details>`
        : '0',
      entry.warnings.length ? html`<ul>${entry.warnings.map(warning => html`<li>${warning}</li>`)}</ul>` : NONE,
      html`<button class="plain" aria-label=${`Delete ${entry.id}`} onClick=${() => drop(entry)}>Delete</button>`,
    ])} />`;
}
