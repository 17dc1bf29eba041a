// When the service fits by itself.
import { html } from '../html.js';
import { useList, post, curl } from '../api.js';
import { address, go } from '../router.js';
import { sayFault } from '../say.js';
import { clock, fromNow, words, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Command } from '../parts/frame.js';
import { Shown, Empty } from '../parts/screens.js';

const NIGHTLY = { cron: '30 2 * * *', zone: 'UTC', systems: ['room/*'] };

export function Schedules() {
  const schedules = useList('/schedules');
  const run = name =>
    post(`/schedules/${encodeURIComponent(name)}/run`).then(
      batch => go(address(batch?.id?.startsWith('bat_') ? ['batches', batch.id] : ['jobs'])),
      sayFault,
    );
  return html`<h1>Schedules</h1>
    <${Shown} of=${schedules} what="the schedules"
      empty=${html`<${Empty} title="Nothing is scheduled"><p>This makes a nightly one:</p><${Command}
        text=${curl('/schedules/nightly', { method: 'PUT', body: NIGHTLY })} /></${Empty}>`}
      show=${list => html`<${Table} caption="Schedules" hidden
        columns=${[['name'], ['state'], ['cron'], ['systems'], ['next runs'], ['last run'], ['if missed'], ['']]}
        rows=${list.map(entry => [
          entry.name,
          html`<${Status} of=${entry.enabled ? 'ok' : 'cancelled'} label=${entry.enabled ? 'on' : 'off'} />`,
          html`<code>${entry.cron}</code> ${entry.zone}`,
          entry.systems.join(', '),
          html`${entry.next_runs.slice(0, 5).map((at, index) =>
            html`<div class=${index ? 'quiet' : ''}>${clock(at, entry.zone)}${index ? '' : ` (${fromNow(at)})`}</div>`)}`,
          entry.last_run ? clock(typeof entry.last_run === 'string' ? entry.last_run : entry.last_run.at) : NONE,
          words(entry.misfire),
          html`<button onClick=${() => run(entry.name)}>Run now</button>`,
        ])} />
        <details class="card"><summary>Change one</summary><${Command}
          text=${curl(`/schedules/${list[0].name}`, { method: 'PUT', body: { cron: list[0].cron, zone: list[0].zone,
            systems: list[0].systems } })} /></details>`} />`;
}
