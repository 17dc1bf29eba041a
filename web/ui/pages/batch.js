// Fits of several systems: what became better, what was refused and why. Or diagnoses: what is missing, and where.
import { html, useState } from '../html.js';
import { useResource } from '../api.js';
import { address, systemAddress } from '../router.js';
import { useEvents, hasEnded } from '../events.js';
import { usePaced } from '../pace.js';
import { sentence, signed, words, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Linked } from '../parts/linked.js';
import { Table } from '../parts/table.js';
import { Shown } from '../parts/screens.js';
import { batchName, grouped, standing, Standings } from '../parts/batches.js';

/** As many systems of a group are shown; the others on demand. */
const SHOWN = 12;
const REFUSED = ['rejected', 'held', 'failed'];

export function BatchPage({ id }) {
  const batch = useResource(`/batches/${id}`);
  // Events say how a job stands; why the gate decided so is read again now and then, and in the end.
  const [heard, setHeard] = useState({});
  const readAgain = usePaced(batch);
  const now = batch.data && { ...batch.data, jobs: batch.data.jobs.map(row => latest(row, heard[row.job])) };
  useEvents((kind, data) => {
    if (!['queued', 'started', 'finished'].includes(kind) || !now?.jobs.some(row => row.job === data.id)) return;
    setHeard(before => ({ ...before, [data.id]: data }));
    const left = now.jobs.filter(row => row.job !== data.id && !hasEnded(row)).length;
    readAgain(left === 0 && kind === 'finished');
  });
  return html`<${Shown} of=${batch} what="the batch" show=${() => html`<${Batch} data=${now} />`} />`;
}

/** A row as the newest event has it; what was read later than that is newer. */
function latest(row, job) {
  if (!job || hasEnded(row)) return row;
  return { ...row, state: job.state, outcome: job.outcome, fit: job.fit, diagnosis: job.diagnosis };
}

function Batch({ data }) {
  const ended = data.jobs.filter(hasEnded).length;
  const refused = data.jobs.map(row => ({ ...row, word: standing(row) })).filter(({ word }) => REFUSED.includes(word));
  return html`<h1>${batchName(data, data.jobs.length)}</h1>
    <p class="verdict"><${Status} of=${data.finished ? 'succeeded' : 'running'} label="" /> ${
      data.finished ? sentence(data.summary) : `${ended} of ${data.jobs.length} have ended`
    }.</p>
    <p class="quiet">${data.id}</p>
    ${data.jobs.length > 0 && html`<${Standings} jobs=${data.jobs} />`}
    ${refused.length > 0 && html`<${Reasons} caption="Refused or held, by reason" rows=${refused} />`}
    ${data.skipped.length > 0 && html`<${Reasons} caption="Left out, by reason" rows=${data.skipped.map(row => ({ ...row, word: 'none' }))} />`}
    ${data.kind === 'diagnose' ? html`<${Diagnoses} data=${data} />` : html`<${Fits} jobs=${data.jobs} />`}`;
}

/** Equal reasons together, with the systems that they were given to. */
const Reasons = ({ caption, rows }) =>
  html`<${Table} caption=${caption} columns=${[['how'], ['systems', 'number'], ['why'], ['which']]}
    keys=${grouped(rows).map(({ key }) => key)} rows=${grouped(rows).map(({ word, reason, example, systems }) => [
      short(word, word === 'none' ? 'left out' : word === 'rejected' ? 'refused' : words(word)),
      systems.length,
      html`${reason && html`<b>${reason}</b>, such as: `}${example}`,
      html`<${Several} systems=${systems} />`,
    ])} />`;

function Several({ systems }) {
  const more = systems.slice(SHOWN);
  return html`<${Linked} systems=${systems.slice(0, SHOWN)} />${more.length > 0 && html`<details><summary>and ${more.length} more</summary><${Linked}
    systems=${more} /></details>`}`;
}

/** A status that stays in one line. */
const short = (of, label) => html`<span class="nowrap"><${Status} of=${of} label=${label} /></span>`;

const jobLink = ({ job }) => html`<a href=${address(['jobs', job])}>${job.slice(0, 12)}…</a>`;

const Fits = ({ jobs }) =>
  html`<${Table} caption="Systems" hidden columns=${[['system'], ['state'], ['outcome'], ['error against before', 'number'], ['why'], ['job']]}
    keys=${jobs.map(row => row.job)} rows=${jobs.map(row => [
      html`<a class="nowrap" href=${systemAddress(row.system)}>${row.system}</a>`,
      short(row.state),
      row.outcome ? short(row.outcome) : NONE,
      row.error_ratio === null ? NONE : `${signed((row.error_ratio - 1) * 100, 1)} %`,
      row.why ?? NONE,
      jobLink(row),
    ])} />`;

const GROUPS = [
  ['unknown', 'Something that no effect explains'],
  ['adequate', 'Nothing is missing'],
  ['not_enough_data', 'Too few data to tell'],
];

/** What is missing by effect, then the systems in which nothing has a name, then each with its sentence. */
function Diagnoses({ data: { jobs, diagnosed } }) {
  const to = system => systemAddress(system, 'missing', { diagnosis: jobs.find(job => job.system === system)?.diagnosis });
  const groups = [
    ...diagnosed.named.map(({ effect, systems }) => [html`<a href=${address(['effects', effect.split(':')[0]])}>${effect}</a>`, systems]),
    ...GROUPS.map(([verdict, title]) => [title, diagnosed[verdict]]),
  ].filter(([, systems]) => systems.length > 0);
  return html`
    ${groups.length > 0 && html`<${Table} caption="What is missing" columns=${[['what'], ['systems', 'number'], ['which']]}
      rows=${groups.map(([title, systems]) => [title, systems.length, html`<${Linked} systems=${systems} to=${to} />`])} />`}
    <${Table} caption="Every system" columns=${[['system'], ['state'], ['verdict'], ['why'], ['job']]}
      keys=${jobs.map(row => row.job)} rows=${jobs.map(row => [
        html`<${Linked} systems=${[row.system]} to=${to} />`,
        html`<${Status} of=${row.state} />`,
        row.verdict ? html`<${Status} of=${row.verdict} />` : NONE,
        row.why ?? NONE,
        jobLink(row),
      ])} />`;
}
