// Every system, worst first: which ones are bad, since when, why, and what to do about it.
import { html, useState, useRef, useEffect, useLayoutEffect, useMemo } from '../html.js';
import { useList, post, curl } from '../api.js';
import { address, systemAddress, setQuery, go, keepPlace, keptPlace } from '../router.js';
import { useSystems, SEVERITY } from '../systems.js';
import { useKeys } from '../keys.js';
import { say, sayFault } from '../say.js';
import { number } from '../format.js';
import { Status } from '../parts/status.js';
import { Shown, Empty } from '../parts/screens.js';
import { Command } from '../parts/frame.js';
import { SystemsTable } from './overview-table.js';
import { Tools, Pages, Regroup, density } from './overview-tools.js';
import { sorted, filtered, lines, runs, PAGE_SIZE } from './overview-view.js';

/** How long after the last movement the place is kept with the address. */
const REST_MS = 200;
/** What has the focus in the row where the keyboard is. */
const CURRENT = 'tr[aria-current=true] a, tr[aria-current=true] button';
/** What was selected, for whoever comes back. */
let selected = new Set();

export function Overview({ query }) {
  const systems = useSystems();
  const schedules = useList('/schedules');
  const empty = html`<${Empty} title="No systems yet">
    <p>A system is a room or a plant with its measurements. <a href=${address(['new'])}>Add one</a>, or start the service with real houses:</p>
    <${Command} text="lampyris demo" />
    <p>The same by hand:</p><${Command} text=${curl('/systems/room/1', { method: 'PUT', body: { label: 'Living room', model: 'room2' } })} />
  </${Empty}>`;
  return html`<${Shown} of=${{ ...systems, data: systems.rows }} what="the systems" empty=${empty} show=${rows => html`
    <${Systems} rows=${rows} complete=${systems.complete} running=${systems.running} schedules=${schedules.data} query=${query} />`} />`;
}

/** Keeps where one is with the step of the history, and goes there again when somebody comes back. */
function usePlace(at, setAt, table) {
  const timer = useRef(null);
  const latest = useRef(at);
  latest.current = at;
  const keep = line => {
    latest.current = line;
    clearTimeout(timer.current);
    keepPlace({ top: scrollY, line });
  };
  useLayoutEffect(() => {
    const place = keptPlace();
    if (place?.line) setAt(place.line);
    if (place) scrollTo(0, place.top);
  }, []);
  useEffect(() => {
    const place = keptPlace();
    // The row is only known as the current one once it is drawn so.
    const later = setTimeout(() => {
      if (!place) return;
      table.current?.querySelector(CURRENT)?.focus({ preventScroll: true });
      scrollTo(0, place.top);
    });
    const moved = () => {
      clearTimeout(timer.current);
      timer.current = setTimeout(() => keepPlace({ top: scrollY, line: latest.current }), REST_MS);
    };
    addEventListener('scroll', moved, { passive: true });
    return () => {
      clearTimeout(later);
      clearTimeout(timer.current);
      removeEventListener('scroll', moved);
    };
  }, []);
  return keep;
}

/** A job for one system, or a batch for many. */
async function ask(kind, batch, names) {
  try {
    if (names.length === 1) {
      const job = await post('/jobs', { kind, system: names[0] });
      say(`${names[0]}: ${job.id} waits for its turn`);
    } else if (names.length > 1) {
      const { id } = await post('/jobs', { kind: batch, systems: names });
      go(address(['batches', id]));
    }
  } catch (error) {
    sayFault(error);
  }
}
const refit = names => ask('estimate', 'recalibrate', names);
const diagnose = names => ask('diagnose', 'diagnose', names);

function Systems({ rows, complete, running, schedules, query }) {
  const [chosen, setChosen] = useState(selected);
  selected = chosen;
  const [at, setLine] = useState(null);
  const [regrouped, setRegrouped] = useState(null);
  const search = useRef(null);
  const table = useRef(null);
  const keep = usePlace(at, setLine, table);
  const setAt = line => {
    setLine(line);
    keep(line);
  };
  const nextRun = useMemo(() => runs(schedules ?? []), [schedules]);
  const { search: typed, health, in: path, next, sort, by, open } = query;
  const order = useMemo(() => sorted(rows, sort, nextRun), [rows, sort, nextRun]);
  const found = useMemo(() => filtered(order, query), [order, typed, health, path, next]);
  const all = useMemo(() => lines(found, query), [found, sort, by, open]);
  const counts = useMemo(() => {
    const sums = {};
    for (const row of rows) sums[row.health] = (sums[row.health] ?? 0) + 1;
    return Object.entries(sums).sort(([a], [b]) => SEVERITY[a] - SEVERITY[b]);
  }, [rows]);
  const page = Math.min(Math.max(Number(query.page) || 1, 1), Math.max(Math.ceil(all.length / PAGE_SIZE), 1));
  const shown = all.slice((page - 1) * PAGE_SIZE, page * PAGE_SIZE);
  const nameOf = line => line.head ?? line.system;
  const place = Math.max(all.findIndex(line => nameOf(line) === at), 0);
  const current = all[place];
  const wanted = useRef(null);
  // At once: an effect that waits for the picture of one step would be taken for that of the next.
  useLayoutEffect(() => {
    // A step to another page ends at its row.
    if (wanted.current) table.current?.querySelector(CURRENT)?.focus();
    wanted.current = null;
  });
  const move = step => {
    const to = Math.min(Math.max(at === null ? 0 : place + step, 0), all.length - 1);
    if (to < 0) return;
    wanted.current = all[to];
    setAt(nameOf(all[to]));
    const its = Math.floor(to / PAGE_SIZE) + 1;
    if (its !== page) setQuery({ page: its === 1 ? null : its });
  };
  const choose = (names, on = true) =>
    setChosen(before => {
      const after = new Set(before);
      for (const name of names) if (on) after.add(name); else after.delete(name);
      return after;
    });
  const toggle = system => choose([system], !chosen.has(system));
  const actions = { choose, refit: ['Refit', refit], diagnose: ['Diagnose', diagnose] };
  const chosenRows = () => rows.filter(row => chosen.has(row.system));
  useKeys({
    '/': ['search', () => search.current?.focus()],
    j: ['next row', () => move(1)],
    k: ['row before', () => move(-1)],
    Enter: [
      null,
      () => {
        const focused = document.activeElement?.closest('a, button, summary');
        if (focused) focused.click();
        else if (current?.system) go(systemAddress(current.system));
      },
    ],
    x: ['select the row', () => current && (current.head ? choose(current.rows.map(row => row.system)) : toggle(current.system))],
    r: ['refit what is selected, or the row', () => refit(chosen.size ? [...chosen] : current?.system ? [current.system] : [])],
    e: ['change the group of what is selected, or of the row', () => setRegrouped(chosen.size ? chosenRows() : current?.system ? [current] : null)],
  });
  const pick = kind => setQuery({ health: query.health === kind ? null : kind, page: null });
  return html`
    <div class="row apart">
      <h1>Systems <span class="quiet">${number(rows.length, 6)}</span></h1>
      <span class="row" role="group" aria-label="Filter by health">
        ${counts.map(([kind, count]) => html`<button aria-pressed=${query.health === kind} onClick=${() => pick(kind)}>
          <${Status} of=${kind} label=${`${count} ${kind === 'attention' ? 'need attention' : kind}`} /></button>`)}
      </span>
      <span class="row">
        <input ref=${search} type="search" placeholder="Search ( / )" aria-label="Search the systems" value=${query.search ?? ''}
          onInput=${event => setQuery({ search: event.target.value, page: null })} />
        <button class="main" disabled=${chosen.size === 0} onClick=${() => refit([...chosen])}>Refit ${chosen.size || ''} selected</button>
        <a class="button" href=${address(['neighbours'])}>Neighbours</a>
        <a class="button" href=${address(['new'])}>Add a system</a>
      </span>
    </div>
    <${Tools} query=${query} page=${page} count=${all.length} chosen=${chosen} complete=${complete}
      regroup=${() => setRegrouped(chosenRows())} />
    <${SystemsTable} shown=${shown} at=${at ?? (current ? nameOf(current) : null)} setAt=${setAt} query=${query} chosen=${chosen} toggle=${toggle}
      all=${found.length > 0 && found.every(row => chosen.has(row.system))} count=${found.length} chooseAll=${on => choose(found.map(row => row.system), on)}
      running=${running} refit=${refit} regroup=${setRegrouped} nextRun=${nextRun} actions=${actions} table=${table}
      compact=${density(query) === 'compact'} />
    ${found.length === 0 && html`<${Empty} title="No system matches"><button
      onClick=${() => setQuery({ search: null, health: null, in: null, next: null, page: null })}>Show all</button></${Empty}>`}
    ${found.length > 0 && html`<div class="row end"><${Pages} page=${page} count=${all.length} /></div>`}
    ${regrouped && html`<${Regroup} rows=${regrouped} groups=${[...new Set(rows.map(row => row.group))].filter(Boolean).sort()}
      close=${() => setRegrouped(null)} />`}`;
}
