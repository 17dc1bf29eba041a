// A length of time as a number of minutes, hours or days; any other one as ISO 8601 writes it.
import { html, useId, useState } from '../html.js';

const UNITS = { minutes: ['PT', 'M'], hours: ['PT', 'H'], days: ['P', 'D'] };
const OTHER = 'other';

/** What is written before the unit; null where the text is of another form. */
function countOf(text, unit) {
  const [before, after] = UNITS[unit];
  const count = text.startsWith(before) && text.endsWith(after) ? text.slice(before.length, -after.length) : null;
  return count !== null && /^\d*$/.test(count) ? count : null;
}

const unitOf = text => Object.keys(UNITS).find(unit => countOf(text, unit) !== null) ?? OTHER;

export function Length({ title, value, change }) {
  const id = useId();
  const [chosen, setChosen] = useState(unitOf(value));
  // What was changed elsewhere may be of another form.
  const unit = chosen === OTHER || countOf(value, chosen) !== null ? chosen : unitOf(value);
  const count = unit === OTHER ? '' : countOf(value, unit);
  const write = (text, of) => change(`${UNITS[of][0]}${text}${UNITS[of][1]}`);
  const choose = ({ target: { value: next } }) => {
    setChosen(next);
    if (next !== OTHER) write(countOf(value, next) ?? count, next);
  };
  return html`<div class="field"><label for=${id}>${title}</label>
    <div class="length">${
      unit === OTHER
        ? html`<input id=${id} value=${value} required spellcheck=${false} placeholder="P1DT12H" onInput=${event => change(event.target.value)} />`
        : html`<input id=${id} type="number" min="1" step="1" required value=${count} onInput=${event => write(event.target.value, unit)} />`
    }<select aria-label=${`Unit: ${title}`} value=${unit} onChange=${choose}>
      ${[...Object.keys(UNITS), OTHER].map(name =>
        html`<option value=${name} selected=${name === unit}>${name === OTHER ? 'as ISO 8601' : name}</option>`)}</select></div>
  </div>`;
}
