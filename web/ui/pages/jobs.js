// The queue, live, and what has ended.
import { html, useState, useRef, useEffect } from '../html.js';
import { useList, useResource, withQuery, post } from '../api.js';
import { address, systemAddress, setQuery } from '../router.js';
import { useEvents, hasEnded } from '../events.js';
import { say, sayFault } from '../say.js';
import { clock, fromNow, length, roughly, number, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Shown, Empty } from '../parts/screens.js';

const STATES = ['queued', 'running', 'succeeded', 'failed', 'cancelled'];
const SHOWN = 100;

export function Jobs({ query }) {
  const jobs = useResource(withQuery('/jobs', { page_size: SHOWN, state: query.state }));
  const batches = useList('/batches');
  const schedules = useList('/schedules');
  const [progress, setProgress] = useState({});
  const timer = useRef(null);
  useEffect(() => () => clearTimeout(timer.current), []);
  useEvents((kind, data) => {
    if (kind === 'progress') setProgress(before => ({ ...before, [data.job]: data }));
    else if (kind !== 'incumbent') {
      clearTimeout(timer.current);
      timer.current = setTimeout(() => {
        jobs.reload();
        batches.reload();
      }, 150);
    }
  });
  const next = (schedules.data ?? [])
    .filter(schedule => schedule.enabled)
    .flatMap(schedule => schedule.next_runs.slice(0, 1).map(at => [schedule.name, at]))[0];
  const empty = html`<${Empty} title=${query.state ? `No job is ${query.state}` : 'No jobs yet'}>
    ${next && html`<p>The schedule ${next[0]} runs ${fromNow(next[1])}.</p>`}</${Empty}>`;
  return html`
    <div class="row apart"><h1>Jobs</h1><span class="segments" role="group" aria-label="State">
      <button aria-pressed=${!query.state} onClick=${() => setQuery({ state: null })}>All</button>
      ${STATES.map(state => html`<button aria-pressed=${query.state === state} onClick=${() => setQuery({ state })}><${Status}
        of=${state} /></button>`)}</span></div>
    <${Shown} of=${jobs} what="the jobs" show=${page =>
      page.items.length === 0
        ? empty
        : html`
      <${Table} caption=${`The newest ${page.items.length} jobs`} hidden
        columns=${[['job'], ['state'], ['kind'], ['system'], ['model'], ['why'], ['evaluations', 'number'], ['took', 'number'], ['asked for'], ['']]}
        rows=${page.items.map(job => rowOf(job, progress[job.id]))} />
      ${page.next_page_token && html`<p class="note">Older ones are in <code>GET /jobs</code>.</p>`}`} />
    ${batches.data?.length > 0 && html`<h2>Batches</h2><ul>
      ${batches.data.map(batch => html`<li><a href=${address(['batches', batch.id])}>${batch.id}</a> ${clock(batch.created_at)}</li>`)}</ul>`}`;
}

function rowOf(job, report) {
  const running = job.state === 'running';
  const told = running ? (report ?? job.progress) : null;
  const trials = told?.trials;
  const budget = trials ? null : job.request.budget?.evaluations;
  const act = word => () => post(`/jobs/${job.id}/${word}`).then(() => say(word === 'cancel' ? 'Cancelled' : 'Asked for again'), sayFault);
  return [
    html`<a href=${address(['jobs', job.id])}>${job.id.slice(0, 12)}…</a>`,
    html`<${Status} of=${job.state} />${job.outcome ? html`<br /><${Status} of=${job.outcome} />` : ''}`,
    job.kind,
    html`<a href=${systemAddress(job.system)}>${job.system}</a>`,
    job.model,
    `${job.origin}${job.experiment ? ', experiment' : ''}`,
    html`${told?.evaluations ?? job.evaluations ?? NONE}${running && budget ?
      html`<br /><progress max=${budget} value=${told?.evaluations ?? 0} aria-label="of the budget">
        </progress>` : ''}${trials?.of ? html`<br />${trials.tried} of ${trials.of} effects tried${
      trials.leader ? html`,<br />${trials.leader} leads` : ''}` : ''}${told?.best_validation ? html`<br />best ${number(told.best_validation)}` : ''}`,
    hasEnded(job) ? length(job.wall_s) : told?.eta_s ? `about ${roughly(told.eta_s)} left` : NONE,
    html`<span title=${clock(job.created_at)}>${fromNow(job.created_at)}</span>`,
    hasEnded(job)
      ? html`<button class="plain" aria-label=${`Run ${job.id} again`} onClick=${act('retry')}>Again</button>`
      : html`<button aria-label=${`Cancel ${job.id}`} onClick=${act('cancel')}>Cancel</button>`,
  ];
}
