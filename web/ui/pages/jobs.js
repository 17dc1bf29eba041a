// The queue, live: what runs, what waits in the order of its turn, and what has ended.
import { html, useState } from '../html.js';
import { useList, useResource, withQuery, post } from '../api.js';
import { address, systemAddress, setQuery } from '../router.js';
import { useEvents, hasEnded } from '../events.js';
import { usePaced } from '../pace.js';
import { say, sayFault } from '../say.js';
import { clock, fromNow, length, roughly, number, NONE } from '../format.js';
import { batchName } from '../parts/batches.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Shown, Empty, Failed } from '../parts/screens.js';

const STATES = ['running', 'queued', 'succeeded', 'failed', 'cancelled'];
const ENDED = STATES.slice(2);
/** Rows of a part at first, and as many more each time; the service gives no more at once than the most. */
const STEP = 25;
const MOST = 500;
/** Lists that are read anew while jobs come and go. */
const LISTS = 3;

const RANKS = ['interactive', 'operator', 'nightly'];
const byTime = field => (one, other) => Date.parse(one[field] ?? 0) - Date.parse(other[field] ?? 0);

/** The jobs of a part: those that were read, as the newest events have them, and those that came to it since. */
function present(read, heard, belongs) {
  const known = new Set(read.map(job => job.id));
  return [...read.map(job => heard[job.id] ?? job), ...Object.values(heard).filter(job => !known.has(job.id))].filter(belongs);
}

export function Jobs({ query }) {
  const [sizes, setSizes] = useState({ queued: STEP, ended: STEP });
  const wanted = state => !query.state || query.state === state;
  const wantsEnded = !query.state || ENDED.includes(query.state);
  const running = useResource(wanted('running') ? withQuery('/jobs', { state: 'running', page_size: 100 }) : null);
  const queued = useResource(wanted('queued') ? withQuery('/jobs', { order: 'turn', page_size: sizes.queued }) : null);
  const ended = useResource(wantsEnded ? withQuery('/jobs', { order: 'ended', state: query.state, page_size: sizes.ended }) : null);
  const counts = useResource('/jobs/counts');
  const batches = useResource(withQuery('/batches', { page_size: STEP }));
  const schedules = useList('/schedules');
  const [heard, setHeard] = useState({});
  const [progress, setProgress] = useState({});
  // The rows themselves come with the events; what waits is read on when some of it has gone.
  const [countAgain, queueAgain, batchesAgain] = [counts, queued, batches].map(list => usePaced(list, LISTS));
  useEvents((kind, data) => {
    if (kind === 'progress') setProgress(before => ({ ...before, [data.job]: data }));
    else if (kind !== 'incumbent') {
      setHeard(before => ({ ...before, [data.id]: data }));
      countAgain();
      if (kind === 'started') queueAgain();
      else batchesAgain();
    }
  });
  const next = (schedules.data ?? [])
    .filter(schedule => schedule.enabled)
    .flatMap(schedule => schedule.next_runs.slice(0, 1).map(at => [schedule.name, at]))
    .sort(([, one], [, other]) => Date.parse(one) - Date.parse(other))[0];
  const nextRun = next && html`<p>The schedule ${next[0]} runs ${fromNow(next[1])}.</p>`;
  const more = part => () => setSizes({ ...sizes, [part]: Math.min(sizes[part] + STEP, MOST) });
  const of = state => counts.data?.[state];
  const button = (state, label) => html`<button aria-pressed=${(query.state ?? null) === state} onClick=${() => setQuery({ state })}>${label}</button>`;
  const total = counts.data && Object.values(counts.data).reduce((sum, count) => sum + count, 0);
  const part = (name, title, resource, rows, count, size) => html`<${Part} name=${name} title=${title} of=${resource} rows=${rows}
    count=${count} size=${size} more=${size && more(name)} progress=${progress} />`;
  const listed = resource => resource.data?.items ?? [];
  const runs = present(listed(running), heard, job => job.state === 'running').sort(byTime('started_at'));
  const waits = present(listed(queued), heard, job => job.state === 'queued');
  waits.sort((one, other) => RANKS.indexOf(one.priority) - RANKS.indexOf(other.priority));
  const ends = present(listed(ended), heard, job => (query.state ? job.state === query.state : hasEnded(job))).sort(byTime('ended_at')).reverse();
  return html`
    <div class="row apart"><h1>Jobs</h1><span class="segments" role="group" aria-label="State">
      ${button(null, `All ${total ?? ''}`)}
      ${STATES.map(state => button(state, html`<${Status} of=${state} label=${`${state} ${of(state) ?? ''}`} />`))}</span></div>
    ${counts.error && html`<${Failed} error=${counts.error} retry=${counts.reload} />`}
    ${total === 0 && html`<${Empty} title="No jobs yet">${nextRun}</${Empty}>`}
    ${query.state && of(query.state) === 0 && html`<${Empty} title=${`No job is ${query.state}`}>${nextRun}</${Empty}>`}
    ${wanted('running') && part('running', 'Running', running, runs, of('running'))}
    ${wanted('queued') && part('queued', 'Waiting, in the order of their turn', queued, waits, of('queued'), sizes.queued)}
    ${wantsEnded && part('ended', 'Ended, the newest first', ended, ends,
      query.state ? of(query.state) : counts.data && ENDED.reduce((sum, state) => sum + of(state), 0), sizes.ended)}
    ${listed(batches).length > 0 && html`<h2>Batches</h2><ul>
      ${listed(batches).map(batch => html`<li><a href=${address(['batches', batch.id])}>${batchName(batch, batch.jobs)}</a>${
        batch.finished ? '' : html` <${Status} of="running" />`}</li>`)}</ul>`}`;
}

/** A part of the queue with how many it has; without any it is not there. */
function Part({ name, title, of, rows, count, size, more, progress }) {
  const shown = size ? rows.slice(0, size) : rows;
  return html`<${Shown} of=${of} what=${`what is ${name}`} show=${() => shown.length > 0 && html`
    <section class="queue"><h2>${title} <span class="quiet">${count ?? ''}</span></h2>
    <${Table} caption=${title} hidden columns=${[['job'], ['state'], ['kind'], ['system'], ['model'], ['why'], ['evaluations', 'number'],
      [name === 'running' ? 'time left' : 'took', 'number'], [name === 'ended' ? 'ended' : 'asked for'], ['']]}
      keys=${shown.map(job => job.id)} rows=${shown.map(job => rowOf(job, progress[job.id]))} />
    ${count > shown.length && more && html`<p class="row"><span class="quiet">${shown.length} of ${count} are shown.</span> ${size < MOST
      ? html`<button onClick=${more}>Show ${Math.min(STEP, count - shown.length)} more</button>`
      : html`<span class="quiet">The others are in <code>GET /jobs</code>.</span>`}</p>`}</section>`} />`;
}

function rowOf(job, report) {
  const running = job.state === 'running';
  const told = running ? (report ?? job.progress) : null;
  const trials = told?.trials;
  const budget = trials ? null : job.request.budget?.evaluations;
  const act = word => () => post(`/jobs/${job.id}/${word}`).then(() => say(word === 'cancel' ? 'Cancelled' : 'Asked for again'), sayFault);
  return [
    html`<a href=${address(['jobs', job.id])}>${job.id.slice(0, 12)}…</a>`,
    html`<${Status} of=${job.state} help="quiet" />${job.outcome ? html`<br /><${Status} of=${job.outcome} help="quiet" />` : ''}`,
    job.kind,
    html`<a class="nowrap" href=${systemAddress(job.system)}>${job.system}</a>`,
    job.model,
    `${job.origin}${job.experiment ? ', experiment' : ''}`,
    html`${told?.evaluations ?? job.evaluations ?? NONE}${running && budget ?
      html`<br /><progress max=${budget} value=${told?.evaluations ?? 0} aria-label="of the budget">
        </progress>` : ''}${trials?.of ? html`<br />${trials.tried} of ${trials.of} effects tried${
      trials.leader ? html`,<br />${trials.leader} leads` : ''}` : ''}${told?.best_validation ? html`<br />best ${number(told.best_validation)}` : ''}`,
    hasEnded(job) ? length(job.wall_s) : told?.eta_s ? `about ${roughly(told.eta_s)} left` : NONE,
    html`<span title=${clock(job.ended_at ?? job.created_at)}>${fromNow(job.ended_at ?? job.created_at)}</span>`,
    hasEnded(job)
      ? html`<button class="plain" aria-label=${`Run ${job.id} again`} onClick=${act('retry')}>Again</button>`
      : html`<button aria-label=${`Cancel ${job.id}`} onClick=${act('cancel')}>Cancel</button>`,
  ];
}
