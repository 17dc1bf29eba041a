// A fit that waits for an operator, on top of every tab: what it would change, and the two words that decide.
import { html, useState } from '../html.js';
import { useResource, withQuery } from '../api.js';
import { systemAddress } from '../router.js';
import { number, signed, fixed, percent, clock, unitOf } from '../format.js';
import { Status } from '../parts/status.js';
import { decision, Reason } from '../parts/dialog.js';

const MOST_PARAMETERS = 3;

/** The newest fit of the model that waits, unless something newer is served; `fits` are the newest first. */
export const waitingOf = (fits, model) => {
  const newest = fits.find(fit => (fit.waits_for_operator && fit.model === model) || fit.served);
  return newest?.waits_for_operator ? newest : null;
};

export function Waiting({ system, fit, served, done }) {
  const [asking, setAsking] = useState(null);
  const decide = (word, title, text) => () => setAsking(decision(fit, word, { title, text, done }));
  const gets = `The controller then gets its parameters${served ? ` instead of those of revision ${served.revision}` : '; now it gets none'}.`;
  return html`<section class="waiting" aria-label="A fit waits">
    <div class="row apart">
      <p><${Status} of="suggested" label="A fit waits for your word:" /> <a href=${systemAddress(system, 'parameters', { fit: fit.id })}
        >${`${fit.model} of ${clock(fit.created_at)}`}</a>, ${fit.summary}.</p>
      <span class="row"><button class="main" onClick=${decide('promote', 'Promote the fit that waits', gets)}>Promote</button>
        <button onClick=${decide('reject', 'Reject the fit that waits', 'It will never be served.')}>Reject</button></span>
    </div>
    <${Errors} fit=${fit} served=${served} />
    ${served && html`<${Changes} fit=${fit} served=${served} />`}
    ${asking && html`<${Reason} ...${asking} close=${() => setAsking(null)} />`}
  </section>`;
}

/** The errors on data that neither has seen, both on the same samples; alone, beside holding the last value. */
function Errors({ fit, served }) {
  const compared = useResource(served && withQuery('/compare', { fits: `${served.fit},${fit.id}`, max_points: 1 }));
  const error = (id, output, over) =>
    compared.data?.errors.find(row => row.fit === id && row.output === output && row.horizon === 'free_run' && row.over === over);
  const said = Object.entries(fit.metrics).map(([output, metrics]) => {
    const over = ['unseen', 'range'].find(part => served && error(fit.id, output, part)?.n && error(served.fit, output, part)?.n);
    const [old, now] = over ? [error(served.fit, output, over), error(fit.id, output, over)] : [];
    if (old)
      return html`<p>${output}: the error of the free run over the same ${now.n} ${over === 'unseen' ? 'unseen ' : ''}samples goes from ${
        fixed(old.rmse)} to <b>${fixed(now.rmse)} ${now.unit}</b> (${signed(100 * (now.rmse / old.rmse - 1), 0)} %).</p>`;
    const ahead = metrics.ahead?.PT24H;
    const beside = ahead && `, forecasts a day ahead by ${fixed(ahead.rmse)}; holding the last value errs by ${fixed(ahead.persistence)}`;
    return html`<p>${output}: on unseen data the free run errs by <b>${fixed(metrics.validation_rmse)} ${metrics.unit}</b>${beside ?? ''}.${served && compared.loading ? ' Comparing it with what is served …' : ''}</p>`;
  });
  return html`${said}`;
}

/** How much a parameter changes, over the larger of both values. */
const shareOf = ({ value, old }) => Math.abs(value - old) / Math.max(Math.abs(value), Math.abs(old));

/** The parameters that would change most. */
function Changes({ fit, served }) {
  const found = useResource(`/fits/${fit.id}`);
  if (!found.data) return null;
  if (found.data.model !== served.model) return html`<p>It has another model than what is served, ${served.model}.</p>`;
  const changes = Object.entries(found.data.parameters)
    .map(([name, { value, unit }]) => ({ name, unit: unitOf(unit) && ` ${unitOf(unit)}`, value, old: served.parameters[name] }))
    .filter(({ value, old }) => old !== undefined && old !== value)
    .sort((a, b) => shareOf(b) - shareOf(a))
    .slice(0, MOST_PARAMETERS);
  if (changes.length === 0) return null;
  const by = ({ value, old }) => (old === 0 ? '' : ` (${value > old ? '+' : '−'}${percent(Math.abs(value / old - 1))})`);
  return html`<p>What changes most: ${changes.map((change, at) =>
    html`${at > 0 ? '; ' : ''}<code>${change.name}</code> ${number(change.old)} → <b>${number(change.value)}</b>${change.unit}${by(change)}`)}.</p>`;
}
