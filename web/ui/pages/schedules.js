// When the service fits and diagnoses by itself: what is planned, and a form to change it.
import { html, useState } from '../html.js';
import { useList, post, put, remove } from '../api.js';
import { address, go } from '../router.js';
import { say, sayFault } from '../say.js';
import { clock, words, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Dialog } from '../parts/dialog.js';
import { Failed, Shown, Empty } from '../parts/screens.js';
import { DOES, Editor, Runs, pathOf } from './schedule.js';

/** What is sent back of a schedule that was read. */
const bodyOf = ({ cron, zone, kind, enabled, systems, request }) => ({ cron, zone, kind, enabled, systems, request });

export function Schedules() {
  const schedules = useList('/schedules');
  const [edited, setEdited] = useState(null);
  const [removed, setRemoved] = useState(null);
  const run = entry =>
    post(`${pathOf(entry.name)}/run`).then(
      batch => go(address(batch?.id?.startsWith('bat_') ? ['batches', batch.id] : ['jobs'])),
      sayFault,
    );
  const pause = entry =>
    put(pathOf(entry.name), { ...bodyOf(entry), enabled: !entry.enabled }).then(() => {
      say(`${entry.name} ${entry.enabled ? 'is paused' : 'runs again'}`);
      schedules.reload();
    }, sayFault);
  const make = html`<button class="main" onClick=${() => setEdited({})}>New schedule</button>`;
  return html`
    <div class="row apart"><h1>Schedules</h1>${make}</div>
    <${Shown} of=${schedules} what="the schedules" empty=${html`<${Empty} title="Nothing is scheduled"><p>A schedule fits systems anew by itself,
      every night for example, or looks for what their models are missing, every week.</p></${Empty}>`}
      show=${list => html`<${Table} caption="Schedules" hidden
        columns=${[['name'], ['state'], ['when'], ['systems'], ['next runs'], ['last run'], ['']]}
        rows=${list.map(entry => [
          entry.name,
          html`<${Status} of=${entry.enabled ? 'ok' : 'cancelled'} label=${entry.enabled ? 'on' : 'paused'} />`,
          html`${entry.in_words}<br /><span class="quiet"><code class="nowrap">${entry.cron}</code> ${entry.zone}</span>`,
          html`${entry.systems.join(', ')}<br /><span class="quiet">${DOES[entry.kind]}</span>`,
          entry.enabled ? html`<${Runs} at=${entry.next_runs} zone=${entry.zone} />` : NONE,
          html`${
            entry.last_run
              ? html`<a class="nowrap" href=${address(['batches', entry.last_run.batch])}>${clock(entry.last_run.at, entry.zone)}</a>`
              : NONE
          }${entry.last_result && html`<br /><span class="quiet">${words(entry.last_result)}</span>`}`,
          html`<span class="row nowrap">
            <button aria-label=${`Run now: ${entry.name}`} onClick=${() => run(entry)}>Run now</button>
            <button aria-label=${`Edit ${entry.name}`} onClick=${() => setEdited(entry)}>Edit</button>
            <button aria-label=${`${entry.enabled ? 'Pause' : 'Resume'} ${entry.name}`} onClick=${() => pause(entry)}>${
              entry.enabled ? 'Pause' : 'Resume'
            }</button>
            <button aria-label=${`Delete ${entry.name}`} onClick=${() => setRemoved(entry)}>Delete</button></span>`,
        ])} />
        <p class="note">Runs that were missed while the service was down are made up for once.</p>`} />
    ${edited && html`<${Editor} schedule=${edited.name ? { name: edited.name, ...bodyOf(edited) } : null} taken=${schedules.data ?? []}
      close=${() => setEdited(null)} done=${name => {
        say(`${name} is kept`);
        setEdited(null);
        schedules.reload();
      }} />`}
    ${removed && html`<${Removal} schedule=${removed} close=${() => setRemoved(null)} done=${() => {
      say(`${removed.name} is deleted`);
      setRemoved(null);
      schedules.reload();
    }} />`}`;
}

function Removal({ schedule, close, done }) {
  const [error, setError] = useState(null);
  return html`<${Dialog} title=${`Delete ${schedule.name}?`} close=${close}>
    <p>It runs no more. What it has submitted stays.</p>
    ${error && html`<${Failed} error=${error} />`}
    <p class="row end">
      <button onClick=${close}>Leave it</button>
      <button class="main" disabled=${error !== null} onClick=${() => remove(pathOf(schedule.name)).then(done, setError)}>Delete it</button>
    </p>
  </${Dialog}>`;
}
