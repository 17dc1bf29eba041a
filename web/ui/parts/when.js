// A date and time on the clock of a zone, kept as an instant.
import { html, useId, useState } from '../html.js';
import { instantsOf, offsetName, wallClock } from '../zones.js';

/** `value` is an instant (RFC 3339), empty where there is none yet; `change` hears the new one. */
export function When({ title, value, zone, change }) {
  const id = useId();
  // A time that never comes is no instant, but stays in the field.
  const [skipped, setSkipped] = useState('');
  const text = value ? wallClock(value, zone) : skipped;
  const times = text ? instantsOf(text, zone) : [];
  const never = text !== '' && times.length === 0;
  const write = event => {
    const written = event.target.value;
    const [first = ''] = written ? instantsOf(written, zone) : [];
    setSkipped(first ? '' : written);
    change(first);
  };
  return html`<div class="field">
    <label>${title} (${zone})<input type="datetime-local" step="any" required value=${text} aria-invalid=${never ? 'true' : null}
      aria-describedby=${never ? id : null} onInput=${write} /></label>
    ${times.length === 2 && html`<label>The clock shows it twice<select value=${times.indexOf(value)} onChange=${event => change(times[event.target.value])}>
      ${times.map((at, which) => html`<option value=${which} selected=${at === value}>${
        `${which ? 'after' : 'before'} it is set back, ${offsetName(at, zone)}`}</option>`)}</select></label>`}
    <div id=${id} class="faults" aria-live="polite">${never && html`<p>▲ The clocks of ${zone} are set forward over this time: it never comes.</p>`}</div>
  </div>`;
}
