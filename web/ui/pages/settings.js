// What a system is: its model, where it stands, and what may happen to its parameters without a person.
import { html, useState } from '../html.js';
import { ask, useList, putSystem } from '../api.js';
import { address } from '../router.js';
import { useSystems } from '../systems.js';
import { differences, onto } from '../merge.js';
import { say } from '../say.js';
import { NotSaved } from '../parts/screens.js';
import { Bindings, NextDoor } from '../parts/bindings.js';
import { Length } from '../parts/length.js';
import { Zones } from '../parts/zones.js';

const PRIORS = {
  none: 'nothing but the bounds',
  siblings: 'what the others in its building have',
  log_normal: 'the nominal values, as in the thesis',
};

const MODES = {
  auto: 'publish what the gate accepts',
  suggest: 'suggest it, and wait for a person',
  observe: 'only watch',
};

export function Settings({ system, document, changed }) {
  const models = useList('/models');
  const { rows } = useSystems();
  // What the draft began as: it may be read anew meanwhile, which must not pass for having been seen.
  const [base, setBase] = useState(document);
  const [draft, setDraft] = useState(document);
  const [error, setError] = useState(null);
  /** The fields that somebody else changed, after they were taken over. */
  const [others, setOthers] = useState([]);
  const set = change => setDraft({ ...draft, ...change });
  const policy = change => set({ policy: { ...draft.policy, ...change } });
  /** A place or a zone that was emptied is not there, and neither is a location without both. */
  const place = change => {
    const said = Object.entries({ ...draft.location, ...change }).filter(([, value]) => value !== '' && value !== null);
    set({ location: said.length ? Object.fromEntries(said) : null });
  };
  const save = async event => {
    event.preventDefault();
    setError(null);
    try {
      const saved = await putSystem(base, draft);
      say(`${system} is changed`);
      setBase(saved);
      // What was written while it was sent stays.
      setDraft(written => onto(saved, draft, written));
      setOthers([]);
      changed(saved);
    } catch (fault) {
      setError(fault);
    }
  };
  const takeOver = async () => {
    try {
      const now = await ask(`/systems/${system}`);
      setOthers(differences(base, now).map(([path]) => path));
      setDraft(written => onto(now, base, written));
      setBase(now);
      setError(null);
    } catch (fault) {
      setError(fault);
    }
  };
  const { lat = '', lon = '', zone } = draft.location ?? {};
  const degrees = text => (text === '' ? null : Number(text));
  return html`<form class="card" onSubmit=${save}>
    <div class="grid">
      <div>
        <label>What people call it<input value=${draft.label} onInput=${event => set({ label: event.target.value })} /></label>
        <label>Group: where people look for it, as in North house/Floor 2
          <input value=${draft.group ?? ''} maxlength="200" onInput=${event => set({ group: event.target.value })} /></label>
        <label>Model whose fits are served
          <select value=${draft.model ?? ''} onChange=${event => set({ model: event.target.value || undefined })}>
            ${[...new Set([draft.model ?? '', ...(models.data ?? []).map(model => model.id)])].map(
              id => html`<option value=${id} selected=${id === (draft.model ?? '')}>${id || 'none: others read its measurements'}</option>`,
            )}
          </select></label>
        ${draft.model && html`<p><a href=${address(['models', draft.model])}>See its equations</a>, or <a
          href=${address(['edit', 'model'], { system })}>write another model for ${system}</a></p>`}
        <label>Prior on the parameters
          <select value=${typeof draft.prior === 'string' ? draft.prior : 'known'} onChange=${event => set({ prior: event.target.value === 'known' ? document.prior : event.target.value })}>
            ${Object.entries({ ...PRIORS, ...(typeof document.prior === 'string' ? {} : { known: 'what its document says' }) }).map(
              ([prior, says]) => html`<option value=${prior} selected=${prior === (typeof draft.prior === 'string' ? draft.prior : 'known')}>${says}</option>`,
            )}
          </select></label>
      </div>
      <div>
        <label>What happens to a new fit
          <select value=${draft.policy.mode} onChange=${event => policy({ mode: event.target.value })}>
            ${Object.entries(MODES).map(([mode, says]) => html`<option value=${mode} selected=${mode === draft.policy.mode}>${mode}: ${says}</option>`)}
          </select></label>
        <${Length} title="Stale after" value=${draft.policy.stale_after} change=${text => policy({ stale_after: text })} />
        <${Length} title="The controller looks ahead" value=${draft.policy.horizon} change=${text => policy({ horizon: text })} />
        <label class="inline"><input type="checkbox" checked=${draft.policy.refit_when_degraded}
          onChange=${event => policy({ refit_when_degraded: event.target.checked })} /> refit when new measurements contradict it</label>
        <label class="inline"><input type="checkbox" checked=${draft.policy.forget_before_change}
          onChange=${event => policy({ forget_before_change: event.target.checked })} /> forget what was before a parameter changed</label>
      </div>
      <div>
        <label>Latitude, north positive<input type="number" min="-90" max="90" step="any" value=${lat} required=${lon !== ''}
          onInput=${event => place({ lat: degrees(event.target.value) })} /></label>
        <label>Longitude, east positive<input type="number" min="-180" max="180" step="any" value=${lon} required=${lat !== ''}
          onInput=${event => place({ lon: degrees(event.target.value) })} /></label>
        <label>Time zone<input value=${zone ?? ''} list="zones" placeholder="UTC" spellcheck=${false} onChange=${event => place({ zone: event.target.value.trim() })} /></label>
        <${Zones} id="zones" />
        <p class="note">The place gives the position of the sun, the zone the hours and weekdays that people live by. Either may stand alone.</p>
      </div>
    </div>
    ${error && html`<${NotSaved} error=${error} word="Take over what has changed" again=${takeOver}><p>Somebody has changed ${system} since this form
      was opened, and it would be overwritten. What you wrote here stays.</p></${NotSaved}>`}
    ${others.length > 0 && html`<p role="status">▲ Changed by somebody else, and taken over where you had changed nothing: ${others.join(', ')}. Save
      it if it is right so.</p>`}
    <${Bindings} key=${base} channels=${draft.channels} change=${channels => set({ channels })} />
    <${NextDoor} system=${system} neighbours=${draft.neighbours} known=${(rows ?? []).map(row => row.system)}
      change=${neighbours => set({ neighbours })} />
    <p><a href=${address(['neighbours'], { system })}>See which rooms look like neighbours</a></p>
    <p class="row end"><button class="main">Save</button></p>
  </form>`;
}
