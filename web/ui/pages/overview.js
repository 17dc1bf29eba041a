// Every system, worst first: which ones are bad, since when, and why.
import { html, useState, useRef } from '../html.js';
import { ask, useList, useResource, post, curl } from '../api.js';
import { address, systemAddress, setQuery, go } from '../router.js';
import { useEvents } from '../events.js';
import { usePaced } from '../pace.js';
import { useKeys } from '../keys.js';
import { say, sayFault } from '../say.js';
import { NONE, length, fixed, fromNow, clock, plainly } from '../format.js';
import { forecasts } from '../parts/outputs.js';
import { Status, Flags } from '../parts/status.js';
import { explained } from '../parts/term.js';
import { Shown, Empty } from '../parts/screens.js';
import { Command } from '../parts/frame.js';
import { Spark } from '../charts/spark.js';

const SEVERITY = { bad: 0, attention: 1, unknown: 2, ok: 3 };
const TREND = 8;
/** About what the lists say of a row, in bytes. */
const BYTES_PER_ROW = 1000;

/** `/params` is one page: a controller reads it at once. */
const itemsOf = (path, options) => ask(path, options).then(page => page.items);

/** The first output's errors of a fit or of what is served. */
const firstOf = outputs => Object.values(outputs ?? {})[0] ?? null;

/** Whether a schedule means a system: `room/*` or its name. */
const means = (schedule, system) =>
  schedule.systems.some(pattern => pattern === system || (pattern.endsWith('*') && system.startsWith(pattern.slice(0, -1))));

/** What the table shows of a system, gathered from the lists. */
function rowsOf(systems, served, fits, schedules) {
  const rows = systems.map(system => {
    const own = fits.filter(fit => fit.system === system.system && firstOf(fit.metrics));
    const error = firstOf(served.find(entry => entry.system === system.system)?.error);
    const newest = firstOf(own[0]?.metrics);
    const runs = schedules
      .filter(schedule => schedule.enabled && means(schedule, system.system))
      .flatMap(schedule => schedule.next_runs.slice(0, 1));
    return {
      ...system,
      unit: error?.unit ?? newest?.unit ?? '',
      // What was never served has the error of its newest fit, which is said.
      day: error ? (error.ahead?.PT24H ?? null) : (newest?.ahead?.PT24H?.rmse ?? null),
      dayOf: !newest && !error ? null : own[0] && !forecasts(own[0].metrics) ? 'makes no forecasts' : error ? 'served' : 'newest fit',
      // Fits that keep a test part aside, as those of a diagnosis do, were judged on other weeks.
      trend: own
        .filter(fit => !fit.parts.test)
        .slice(0, TREND)
        .map(fit => firstOf(fit.metrics).validation_rmse)
        .filter(Number.isFinite)
        .reverse(),
      next: runs.sort()[0] ?? null,
      // Which of several outputs the numbers are of.
      several: Object.keys(own[0]?.metrics ?? {}).length > 1 ? Object.keys(own[0].metrics)[0] : null,
    };
  });
  return rows.sort((a, b) => SEVERITY[a.health] - SEVERITY[b.health] || (b.day ?? 0) - (a.day ?? 0) || a.system.localeCompare(b.system));
}

/** A text whose long names may be broken at their underscores. */
const breakable = text => text.split(/(?<=_)/).map((part, at) => (at ? html`<wbr />${part}` : part));

export function Overview({ query }) {
  const systems = useList('/systems');
  const served = useResource('/params', { read: itemsOf });
  const fits = useList('/fits');
  const schedules = useList('/schedules');
  const [running, setRunning] = useState({});
  const refresh = usePaced(() => [systems, served, fits].forEach(list => list.reload()));
  useEvents((kind, data) => {
    if (kind === 'incumbent') return;
    setRunning(before => {
      const { [data.system]: _, ...others } = before;
      if (kind === 'finished') return others;
      return { ...before, [data.system]: kind === 'progress' ? `${data.evaluations} evaluations` : kind === 'queued' ? 'waits' : 'runs' };
    });
    if (kind !== 'finished') return;
    const rows = [systems, served, fits].reduce((sum, list) => sum + (list.data?.length ?? 0), 0);
    refresh(rows * BYTES_PER_ROW);
    // Nobody waits for the numbers after the last one.
    ask('/jobs/counts').then(counts => counts.queued + counts.running === 0 && refresh(0), () => {});
  });
  const empty = html`<${Empty} title="No systems yet">
    <p>A system is a room or a plant with its measurements. <a href=${address(['new'])}>Add one</a>, or start the service with real houses:</p>
    <${Command} text="lampyris demo" />
    <p>The same by hand:</p><${Command} text=${curl('/systems/room/1', { method: 'PUT', body: { label: 'Living room', model: 'room2' } })} />
  </${Empty}>`;
  return html`<${Shown} of=${systems} what="the systems" empty=${empty} show=${list => html`
    <${Systems} rows=${rowsOf(list, served.data ?? [], fits.data ?? [], schedules.data ?? [])} running=${running} query=${query} />`} />`;
}

function Systems({ rows, running, query }) {
  const [chosen, setChosen] = useState(new Set());
  const [at, setAt] = useState(0);
  const search = useRef(null);
  const table = useRef(null);
  const counts = Object.entries(rows.reduce((sum, row) => ({ ...sum, [row.health]: (sum[row.health] ?? 0) + 1 }), {})).sort(
    ([a], [b]) => SEVERITY[a] - SEVERITY[b],
  );
  const wanted = (query.search ?? '').toLowerCase();
  const shown = rows.filter(
    row =>
      (!query.health || row.health === query.health) &&
      `${row.system} ${row.label} ${row.model} ${row.why} ${row.flags}`.toLowerCase().includes(wanted),
  );
  const current = shown[Math.min(at, shown.length - 1)];
  const toggle = system =>
    setChosen(before => {
      const after = new Set(before);
      if (!after.delete(system)) after.add(system);
      return after;
    });
  const move = step => {
    const next = Math.min(Math.max(at + step, 0), shown.length - 1);
    setAt(next);
    table.current?.querySelectorAll('tbody a')[next]?.focus();
  };
  const refit = async names => {
    if (names.length === 0) return;
    try {
      if (names.length === 1) {
        const job = await post('/jobs', { kind: 'estimate', system: names[0] });
        say(`${names[0]} is refitted: ${job.id}`);
      } else {
        const batch = await post('/jobs', { kind: 'recalibrate', systems: names });
        go(address(['batches', batch.id]));
      }
    } catch (error) {
      sayFault(error);
    }
  };
  useKeys({
    '/': ['search', () => search.current?.focus()],
    j: ['next row', () => move(1)],
    k: ['row before', () => move(-1)],
    Enter: [
      null,
      () => (document.activeElement?.closest('a, button, summary') ?? null)?.click() ?? (current && go(systemAddress(current.system))),
    ],
    x: ['select the row', () => current && toggle(current.system)],
    r: ['refit what is selected, or the row', () => refit(chosen.size ? [...chosen] : current ? [current.system] : [])],
  });
  return html`
    <div class="row apart">
      <h1>Systems <span class="quiet">${rows.length}</span></h1>
      <span class="row" role="group" aria-label="Filter by health">
        ${counts.map(
          ([
            health,
            count,
          ]) => html`<button aria-pressed=${query.health === health} onClick=${() => setQuery({ health: query.health === health ? null : health })}>
          <${Status} of=${health} label=${`${count} ${health === 'attention' ? 'need attention' : health}`} /></button>`,
        )}
      </span>
      <span class="row">
        <input ref=${search} type="search" placeholder="Search ( / )" aria-label="Search the systems" value=${query.search ?? ''}
          onInput=${event => setQuery({ search: event.target.value })} />
        <button class="main" disabled=${chosen.size === 0} onClick=${() => refit([...chosen])}>Refit ${chosen.size || ''} selected</button>
        <a class="button" href=${address(['neighbours'])}>Neighbours</a>
        <a class="button" href=${address(['new'])}>Add a system</a>
      </span>
    </div>
    <div class="scroll" tabindex="0" role="region" aria-label="Systems, worst first"><table role="table" class="systems cards" ref=${table}>
      <caption class="unseen">Systems, worst first</caption>
      <thead role="rowgroup"><tr role="row">
        <th role="columnheader" scope="col"><span class="unseen">Selected</span></th><th role="columnheader" scope="col">System</th><th role="columnheader" scope="col">Health, and why</th><th
          role="columnheader" scope="col">${explained('Served')}</th>
        <th role="columnheader" scope="col" class="number">${explained('24 h ahead')}</th><th role="columnheader" scope="col">${explained('Validation')}</th><th role="columnheader" scope="col">${explained('Fails most')}</th><th
          role="columnheader" scope="col">${explained('Flags')}</th><th role="columnheader" scope="col">Next fit</th><th role="columnheader" scope="col"><span class="unseen">Refit</span></th>
      </tr></thead>
      <tbody role="rowgroup">${shown.map(
        (
          row,
          index,
        ) => html`<tr role="row" key=${row.system} class=${chosen.has(row.system) ? 'chosen' : ''} aria-current=${index === at ? 'true' : null}>
        <td role="cell"><input type="checkbox" aria-label=${`Select ${row.system}`} checked=${chosen.has(row.system)} onChange=${() => toggle(row.system)} /></td>
        <th role="rowheader" scope="row" class="name"><a href=${systemAddress(row.system)} onFocus=${() => setAt(index)}>${row.system}</a><small
          title=${row.label}>${row.label || row.model}</small></th>
        <td role="cell" data-label="Health"><${Status} of=${row.health} help="quiet" /><div class="why clamped" title=${row.why}>${breakable(plainly(row.why))}</div></td>
        <td role="cell" data-label="Served" class="nowrap"><${Status} of=${row.status ?? 'none'} help="quiet" /><small>
          ${row.revision === null ? 'no revision' : `revision ${row.revision}, ${length(row.age_s)} old`}</small></td>
        <td role="cell" data-label="24 h ahead" class="number">${row.day === null ? NONE : `${fixed(row.day)} ${row.unit}`}<small>${row.dayOf ?? ''}</small></td>
        <td role="cell" data-label="Validation">${row.trend.length ? html`<${Spark} values=${row.trend} unit=${row.unit} /><small>last ${fixed(row.trend.at(-1))} ${row.unit}${row.several ? ` of ${row.several}` : ''}</small>` : NONE}</td>
        <td role="cell" data-label="Fails most"><div class="regime clamped" title=${row.worst_regime ?? ''}>${row.worst_regime ?? NONE}</div></td>
        <td role="cell" data-label="Flags">${row.flags.length ? html`<${Flags} of=${row.flags} most=${2} />` : NONE}</td>
        <td role="cell" data-label="Next fit" class="nowrap">${row.next ? html`<span title=${clock(row.next)}>${fromNow(row.next)}</span>` : NONE}</td>
        <td role="cell">${
          running[row.system]
            ? html`<${Status} of="running" label=${running[row.system]} />`
            : html`<button class="plain" aria-label=${`Refit ${row.system}`} onClick=${() => refit([row.system])}>Refit</button>`
        }</td>
      </tr>`,
      )}</tbody>
    </table></div>
    ${shown.length === 0 && html`<${Empty} title="No system matches"><button
      onClick=${() => setQuery({ search: null, health: null })}>Show all</button></${Empty}>`}`;
}
