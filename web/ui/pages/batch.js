// Fits of several systems: what became better, what was refused and why. Or diagnoses: what is missing, and where.
import { html } from '../html.js';
import { useResource } from '../api.js';
import { address, systemAddress } from '../router.js';
import { useEvents } from '../events.js';
import { clock, signed, words, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Shown } from '../parts/screens.js';

export function BatchPage({ id }) {
  const batch = useResource(`/batches/${id}`);
  useEvents(kind => (kind === 'finished' || kind === 'started') && batch.reload());
  return html`<h1>Batch of ${batch.data?.kind === 'diagnose' ? 'diagnoses' : 'fits'}</h1><${Shown} of=${batch} what="the batch" show=${data => html`
    <p class="verdict"><${Status} of=${data.finished ? 'succeeded' : 'running'}
      label="" /> ${data.summary[0].toUpperCase()}${data.summary.slice(1)}.</p>
    <p class="quiet">${data.id}, ${clock(data.created_at)}${data.schedule ? `, by the schedule ${data.schedule}` : ''}.</p>
    ${data.kind === 'diagnose' ? html`<${Diagnoses} data=${data} />` : html`<${Fits} jobs=${data.jobs} />`}
    ${data.skipped.length > 0 && html`<h2>Left out</h2><ul>
      ${data.skipped.map(row => html`<li>${typeof row === 'string' ? row : `${row.system}: ${row.why ?? row.reason}`}</li>`)}</ul>`}`} />`;
}

const jobLink = ({ job }) => html`<a href=${address(['jobs', job])}>${job.slice(0, 12)}…</a>`;

const Fits = ({ jobs }) =>
  html`<${Table} caption="Systems" hidden columns=${[['system'], ['state'], ['outcome'], ['error against before', 'number'], ['why'], ['job']]}
    rows=${jobs.map(row => [
      html`<a href=${systemAddress(row.system)}>${row.system}</a>`,
      html`<${Status} of=${row.state} />`,
      row.outcome ? html`<${Status} of=${row.outcome} />` : NONE,
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
function Diagnoses({ data: { jobs, diagnosed, rejected } }) {
  const place = system => {
    const { diagnosis } = jobs.find(job => job.system === system) ?? {};
    return html`<a href=${systemAddress(system, 'missing', diagnosis ? { diagnosis } : {})}>${system}</a>`;
  };
  const list = systems => systems.map((system, at) => html`${at ? ', ' : ''}${place(system)}`);
  const groups = [
    ...diagnosed.named.map(({ effect, systems }) => [html`<a href=${address(['effects', effect.split(':')[0]])}>${effect}</a>`, systems]),
    ...GROUPS.map(([verdict, title]) => [title, diagnosed[verdict]]),
    ['No diagnosis', rejected.map(({ system }) => system)],
  ].filter(([, systems]) => systems.length > 0);
  return html`
    ${groups.length > 0 && html`<${Table} caption="What is missing" columns=${[['what'], ['systems', 'number'], ['which']]}
      rows=${groups.map(([title, systems]) => [title, systems.length, list(systems)])} />`}
    <${Table} caption="Every system" columns=${[['system'], ['state'], ['verdict'], ['why'], ['job']]}
      rows=${jobs.map(row => [
        place(row.system),
        html`<${Status} of=${row.state} />`,
        row.verdict ? html`<${Status} of=${row.verdict === 'named' ? 'attention' : row.verdict} label=${words(row.verdict)} />` : NONE,
        row.why ?? NONE,
        jobLink(row),
      ])} />`;
}
