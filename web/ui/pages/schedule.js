// The form of one schedule. While one types, the service says what it would do, and what is wrong at which field.
import { html, useEffect, useId, useState } from '../html.js';
import { post, put } from '../api.js';
import { clock, fromNow } from '../format.js';
import { Dialog } from '../parts/dialog.js';
import { Faults } from '../parts/screens.js';
import { Zones } from '../parts/zones.js';

const QUIET_MS = 250;
const NIGHTLY = { cron: '30 2 * * *', zone: '', kind: 'recalibrate', enabled: true, systems: ['room/*'], request: {} };
/** What a schedule does, in the words of the form and of the list. */
export const DOES = { recalibrate: 'fits it anew', diagnose: 'looks for what is missing' };

export const pathOf = name => `/schedules/${encodeURIComponent(name)}`;

/** The field that a fault belongs to. */
const fieldOf = ({ pointer }) =>
  pointer === 'path' ? 'name' : (['cron', 'zone', 'kind', 'systems', 'request'].find(field => pointer.startsWith(`/${field}`)) ?? 'form');

/** What the form says, as the service reads it; `faults` is what stops it from being sent. */
function read(draft) {
  const body = { cron: draft.cron.trim(), kind: draft.kind, enabled: draft.enabled, systems: draft.systems.split(/[\s,]+/).filter(Boolean) };
  if (draft.zone.trim()) body.zone = draft.zone.trim();
  try {
    return { body: { ...body, request: draft.request.trim() ? JSON.parse(draft.request) : {} }, faults: [] };
  } catch (error) {
    return { body, faults: [{ pointer: '/request', detail: `this is no JSON: ${error.message}` }] };
  }
}

/** The next runs on the clock of the schedule's zone, the first with how long it takes until then. */
export const Runs = ({ at, zone }) =>
  at.length === 0
    ? html`never`
    : html`${at.map(
        (run, index) => html`<div class="nowrap ${index ? 'quiet' : ''}">${clock(run, zone)}${index ? '' : ` (${fromNow(run)})`}</div>`,
      )}`;

export function Editor({ schedule, taken, close, done }) {
  const start = schedule ?? { name: '', ...NIGHTLY };
  const [draft, setDraft] = useState({
    ...start,
    systems: start.systems.join(', '),
    request: Object.keys(start.request).length ? JSON.stringify(start.request, null, 2) : '',
  });
  const [plan, setPlan] = useState(null);
  const [faults, setFaults] = useState([]);
  const [busy, setBusy] = useState(false);
  const set = change => setDraft({ ...draft, ...change });
  const name = draft.name.trim();
  const written = JSON.stringify(draft);
  const heard = error => {
    setPlan(null);
    setFaults(error.errors?.length ? error.errors : [{ pointer: '', detail: error.detail ?? error.message }]);
  };
  useEffect(() => {
    const { body, faults: own } = read(draft);
    if (own.length) {
      heard({ errors: own });
      return undefined;
    }
    let late = false;
    const timer = setTimeout(() => {
      // The name is asked for when it is kept; until then any will do.
      post(`${pathOf(name || 'new')}/preview`, body).then(
        answer => {
          if (late) return;
          setPlan(answer);
          setFaults([]);
        },
        error => late || heard(error),
      );
    }, QUIET_MS);
    return () => {
      late = true;
      clearTimeout(timer);
    };
  }, [written]);
  const keep = async event => {
    event.preventDefault();
    const { body, faults: own } = read(draft);
    if (own.length) return;
    setBusy(true);
    try {
      await put(pathOf(name), body);
      done(name);
    } catch (error) {
      heard(error);
      setBusy(false);
    }
  };
  const of = field => faults.filter(fault => fieldOf(fault) === field);
  const replaces = !schedule && taken.some(entry => entry.name === name);
  return html`<${Dialog} title=${schedule ? `Schedule ${schedule.name}` : 'New schedule'} close=${close}>
    <form class="schedule" onSubmit=${keep}>
      ${
        !schedule &&
        html`<${Field} title="Name" faults=${[
          ...of('name'),
          ...(replaces ? [{ detail: `there is a schedule ${name}: keeping this one replaces it` }] : []),
        ]} input=${props =>
          html`<input ...${props} value=${draft.name} required autofocus onInput=${event => set({ name: event.target.value })} />`} />`
      }
      <${Field} title="What it does with each system" faults=${of('kind')} input=${props =>
        html`<select ...${props} value=${draft.kind} onChange=${event => set({ kind: event.target.value })}>
          ${Object.entries(DOES).map(([kind, says]) => html`<option value=${kind} selected=${kind === draft.kind}>${says}</option>`)}</select>`} />
      <${Field} title="When: minute, hour, day of the month, month, day of the week" faults=${of('cron')} input=${props =>
        html`<input ...${props} class="code" value=${draft.cron} required autofocus=${Boolean(schedule)} spellcheck=${false}
          onInput=${event => set({ cron: event.target.value })} />`} />
      <${Field} title="Time zone; empty is that of the service" faults=${of('zone')} input=${props =>
        html`<input ...${props} value=${draft.zone} list="zones" placeholder=${plan?.zone ?? ''} spellcheck=${false}
          onInput=${event => set({ zone: event.target.value })} />`} />
      <${Zones} id="zones" />
      <${Field} title="Systems: names such as room/4, or all of a kind, room/*" faults=${of('systems')} input=${props =>
        html`<input ...${props} value=${draft.systems} required spellcheck=${false} onInput=${event => set({ systems: event.target.value })} />`} />
      <${Field} title="What is asked of each, as in the body of a job (JSON); empty leaves the defaults" faults=${of('request')} input=${props =>
        html`<textarea ...${props} rows="3" spellcheck=${false} placeholder=${draft.kind === 'diagnose' ? '{"accusation_rate": 0.01}' : '{"budget": {"evaluations": 20000}}'}
          value=${draft.request} onInput=${event => set({ request: event.target.value })}></textarea>`} />
      <label class="inline"><input type="checkbox" checked=${draft.enabled} onChange=${event => set({ enabled: event.target.checked })} /> it runs;
        otherwise it is paused</label>
      <div class="plan" role="status">${
        plan &&
        html`<p><b>${plan.in_words}</b> <span class="quiet">${draft.enabled ? 'The next runs' : 'If it were not paused'}, on the clock of ${plan.zone}:</span></p>
        <${Runs} at=${plan.next_runs} zone=${plan.zone} />`
      }</div>
      <${Faults} errors=${of('form')} />
      <p class="row end">
        <button type="button" onClick=${close}>Leave it</button>
        <button class="main" disabled=${busy}>${schedule ? 'Keep the change' : 'Make it'}</button>
      </p>
    </form>
  </${Dialog}>`;
}

/** Where in a field a fault lies: `budget/evaluations` of the request. */
const within = ({ pointer }) => /^\/request\/(.*)/.exec(pointer ?? '')?.[1];

/** A field with what is wrong at it. `input` gets what ties the two together. */
function Field({ title, faults, input }) {
  const id = useId();
  const wrong = faults.some(fault => fault.pointer !== undefined);
  return html`<div class="field">
    <label>${title}${input({ 'aria-invalid': wrong ? 'true' : null, 'aria-describedby': faults.length ? id : null })}</label>
    <div id=${id} class="faults" aria-live="polite">${faults.map(
      fault =>
        html`<p>▲ ${within(fault) && html`<code>${within(fault)}</code> `}${fault.detail}${fault.suggestion ? html` <em>${fault.suggestion}</em>` : ''}</p>`,
    )}</div>
  </div>`;
}
