// What each night has come to: what to do next, what changed, who was refused and why.
import { html } from '../html.js';
import { useList, useResource } from '../api.js';
import { address, systemAddress } from '../router.js';
import { useEvents } from '../events.js';
import { usePaced } from '../pace.js';
import { clock, fixed, horizon, number, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Linked } from '../parts/linked.js';
import { Table } from '../parts/table.js';
import { Command } from '../parts/frame.js';
import { Shown, Empty } from '../parts/screens.js';

/** Systems that are named in a row; of more the number is told. */
const NAMED = 10;

const date = night => new Intl.DateTimeFormat('en-GB', { weekday: 'long', day: 'numeric', month: 'long', year: 'numeric', timeZone: 'UTC' }).format(new Date(night));

export function Mornings() {
  const nights = useList('/nights');
  const again = usePaced(nights);
  useEvents(kind => kind === 'finished' && again());
  const empty = html`<${Empty} title="No night has passed yet"><p>Schedules fit and diagnose rooms by night; each morning has a report here.
    <a href=${address(['schedules'])}>See when they run</a>, or run one now.</p></${Empty}>`;
  return html`<h1>Mornings</h1>
    <p>What each night has come to: what changed, who was refused and why, and what to do next. The same is a mail:${' '}
      <code>GET /nights/${'{date}'}</code> as <code>text/html</code>.</p>
    <${Shown} of=${nights} what="the nights" empty=${empty} show=${list => {
      const days = new Map();
      for (const row of list) days.set(row.night, [...(days.get(row.night) ?? []), row]);
      return html`<${Table} caption="Nights, newest first" columns=${[['night'], ['what was done'], ['jobs', 'number'], ['']]}
        rows=${[...days].map(([night, rows]) => [
          html`<a href=${address(['mornings', night])}>${date(night)}</a>`,
          rows.map(row => `${row.schedule ?? 'by hand'}: ${row.kind}`).join(', '),
          rows.reduce((sum, row) => sum + row.jobs, 0),
          html`<${Status} of=${rows.every(row => row.finished) ? 'ok' : 'running'} label=${rows.every(row => row.finished) ? 'done' : 'still runs'} />`,
        ])} />`;
    }} />`;
}

export function Morning({ id }) {
  const night = useResource(`/nights/${encodeURIComponent(id)}`);
  const again = usePaced(night);
  useEvents(kind => kind === 'finished' && night.data && !night.data.finished && again());
  return html`<${Shown} of=${night} what="the report" show=${data => html`<${Report} data=${data} />`} />`;
}

function Report({ data }) {
  const isDay = /^\d{4}-\d{2}-\d{2}$/.test(data.night);
  const mail = `${location.origin}/nights/${data.night}`;
  return html`
    <p><a href=${address(['mornings'])}>All mornings</a></p>
    <div class="row apart"><h1>${isDay ? date(data.night) : `Night of ${clock(data.at)}`}</h1>
      <span class="row">${data.batches.map(
        batch => html`<a class="button" href=${address(['batches', batch.batch])}>${batch.schedule ?? 'batch'}: ${batch.kind}</a>`,
      )}</span></div>
    <p class="verdict">${data.summary}</p>
    ${!data.finished && html`<p role="status"><${Status} of="running" label="It is not done yet: some jobs still wait or run." /></p>`}
    <h2>What to do next</h2>
    ${data.next.length === 0 && html`<p><${Status} of="ok" label="Nothing: every room serves what it should." /></p>`}
    ${data.next.length > 0 && html`<ol class="next">${data.next.map(
      step => html`<li><a href=${step.link}>${step.what}</a> ${step.systems.length > 1 && html`<${Names} systems=${step.systems} />`}</li>`,
    )}</ol>`}
    ${data.doubtful.length > 0 && html`<${Table} caption="Not to be relied on now" columns=${[['system'], ['status'], ['since'], ['last measured'], ['why']]}
      rows=${data.doubtful.map(one => [
        html`<a href=${systemAddress(one.system, one.status === 'degraded' ? 'fails' : 'data')}>${one.system}</a>`,
        html`<${Status} of=${one.status} />`,
        one.since ? clock(one.since) : NONE,
        one.measured_to ? clock(one.measured_to) : NONE,
        one.why,
      ])} />`}
    ${data.refused.length > 0 && html`<${Table} caption="Refused, and why" columns=${[['systems', 'number'], ['rule'], ['outcome'], ['why, of the first'], ['who']]}
      rows=${data.refused.map(group => [
        group.systems.length,
        group.rule,
        html`<${Status} of=${group.outcome} />`,
        group.why,
        html`<${Names} systems=${group.systems} tab="parameters" />`,
      ])} />`}
    ${data.changed.length > 0 && html`<${Table} caption="New parameters, the largest gain first"
      columns=${[['system'], ['model'], ['revision', 'number'], ['error before', 'number'], ['error now', 'number'], ['ahead'], ['']]}
      rows=${data.changed.map(one => [
        html`<a href=${systemAddress(one.system, 'parameters')}>${one.system}</a>`,
        one.model,
        one.revision,
        one.before === null ? NONE : `${fixed(one.before)} ${one.unit}`,
        one.after === null ? NONE : `${fixed(one.after)} ${one.unit}`,
        one.horizon ? horizon(one.horizon) : 'free run',
        one.before === null ? 'nothing was served before' : html`<${Turn} before=${one.before} after=${one.after} />`,
      ])} />`}
    ${data.confirmed.length > 0 && html`<h2>Good already</h2><p><${Names} systems=${data.confirmed} most=${60} /></p>`}
    ${data.skipped.length > 0 && html`<${Table} caption="Left out" columns=${[['systems', 'number'], ['why'], ['who']]}
      rows=${data.skipped.map(group => [group.systems.length, group.why, html`<${Names} systems=${group.systems} tab="data" />`])} />`}
    <h2>As a mail</h2>
    <p>The report as a page by itself, for a mail program; a service with tokens wants one that may read.</p>
    <${Command} text=${`curl -s -H 'accept: text/html' '${mail}'`} />`;
}

/** Which way an error went, in a word. */
function Turn({ before, after }) {
  const share = after / before;
  if (share < 0.99) return html`<${Status} of="ok" label=${`${number((1 - share) * 100, 2)} % less`} />`;
  return share > 1.01 ? html`<${Status} of="attention" label=${`${number((share - 1) * 100, 2)} % more`} />` : html`<${Status} of="unchanged" label="as before" />`;
}

function Names({ systems, tab, most = NAMED }) {
  const more = systems.length - most;
  return html`<${Linked} systems=${systems.slice(0, most)} to=${system => systemAddress(system, tab)} />${more > 0 ? ` and ${more} more` : ''}`;
}
