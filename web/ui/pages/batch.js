// A recalibration of several systems: what became better, what was refused and why.
import { html } from '../html.js';
import { useResource } from '../api.js';
import { address, systemAddress } from '../router.js';
import { useEvents } from '../events.js';
import { clock, signed, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Shown } from '../parts/screens.js';

export function BatchPage({ id }) {
  const batch = useResource(`/batches/${id}`);
  useEvents(kind => (kind === 'finished' || kind === 'started') && batch.reload());
  return html`<h1>Batch of fits</h1><${Shown} of=${batch} what="the batch" show=${data => html`
    <p class="verdict"><${Status} of=${data.finished ? 'succeeded' : 'running'}
      label="" /> ${data.summary[0].toUpperCase()}${data.summary.slice(1)}.</p>
    <p class="quiet">${data.id}, ${clock(data.created_at)}${data.schedule ? `, by the schedule ${data.schedule}` : ''}.</p>
    <${Table} caption="Systems" hidden columns=${[['system'], ['state'], ['outcome'], ['error against before', 'number'], ['why'], ['job']]}
      rows=${data.jobs.map(row => [
        html`<a href=${systemAddress(row.system)}>${row.system}</a>`,
        html`<${Status} of=${row.state} />`,
        row.outcome ? html`<${Status} of=${row.outcome} />` : NONE,
        row.error_ratio === null ? NONE : `${signed((row.error_ratio - 1) * 100, 1)} %`,
        row.why ?? NONE,
        html`<a href=${address(['jobs', row.job])}>${row.job.slice(0, 12)}…</a>`,
      ])} />
    ${data.skipped.length > 0 && html`<h2>Left out</h2><ul>
      ${data.skipped.map(row => html`<li>${typeof row === 'string' ? row : `${row.system}: ${row.why ?? row.reason}`}</li>`)}</ul>`}`} />`;
}
