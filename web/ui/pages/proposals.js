// Terms that no catalogue has: sought on demand, each with its equation, its document, and what it leaves of the error.
import { html, useState } from '../html.js';
import { ask, useResource } from '../api.js';
import { REPORT } from '../carried.js';
import { number, percent } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Failed, Loading } from '../parts/screens.js';

const UNPROCESSABLE = 422;

/** `add` hears the id and the title of an effect that was taken; null where nothing can be added now. */
export function Proposals({ fit, add }) {
  const [asked, setAsked] = useState(false);
  if (REPORT) return null;
  return html`<section class="card" aria-labelledby="proposals"><h3 id="proposals">A term that no catalogue has</h3>
    ${
      asked
        ? html`<${Sought} path=${`/fits/${fit}/proposals`} add=${add} />`
        : html`<p>Every channel that was measured, the sun and the clock can be tried as a term of the model: as they are, above a threshold, later, at certain hours. It takes some seconds.</p>
          <p><button onClick=${() => setAsked(true)}>Propose a term</button></p>`
    }
  </section>`;
}

function Sought({ path, add }) {
  const found = useResource(path);
  if (found.error?.status === UNPROCESSABLE)
    return html`<p class="note">No term can be sought here: ${found.error.errors?.[0]?.detail ?? found.error.detail}.</p>`;
  if (found.error) return html`<${Failed} error=${found.error} retry=${found.reload} />`;
  if (found.data === null) return html`<${Loading} what="the terms that are tried" />`;
  const { sentences, proposals, tried, shifts, by_chance: byChance } = found.data;
  return html`<ul>${sentences.map(says => html`<li>${says}</li>`)}</ul>
    ${proposals.map(one => html`<${Proposal} key=${one.effect} proposal=${one} add=${add} />`)}
    <p class="note">${tried} terms were tried on the error over the next 12 h, and on ${shifts} errors shifted by whole days${
      byChance === null ? '' : `: by chance the best explains up to ${percent(byChance)} in all but few rooms`
    }.</p>
    ${proposals.length > 0 && html`<${Frame} title="What is left with each" path=${path}
      summary=${`The squared error that is left with each of ${proposals.length} terms.`}
      table=${() => ({
        columns: [['effect'], ['left of the error', 'number'], ['explains', 'number'], ['confirmed', 'number'], ['t', 'number'], ['size', 'number'], ['unit']],
        rows: proposals.map(one => [one.effect, percent(one.left), percent(one.share), percent(one.confirmed), number(one.t), number(one.size), one.unit]),
      })}>
      <${Table} caption="What is left of the squared error, 12 h ahead" columns=${[['term'], ['left', 'number'], ['explains beside its own parameters', 'number'], ['size', 'number']]}
        rows=${proposals.map(one => [one.effect, percent(one.left), percent(one.share), `${number(one.size)} ${one.unit}`])} />
    </${Frame}>`}`;
}

function Proposal({ proposal, add }) {
  const [error, setError] = useState(null);
  const [busy, setBusy] = useState(false);
  const take = async () => {
    setBusy(true);
    setError(null);
    try {
      await ask('/effects', { method: 'POST', body: proposal.document });
      add({ effect: proposal.effect, title: proposal.document.title });
    } catch (failure) {
      setError(failure);
    }
    setBusy(false);
  };
  return html`<article class="finding" aria-label=${proposal.effect}>
    <p><strong>${proposal.sentence}</strong></p>
    <p><code>${proposal.equation}</code> with ${number(proposal.size)} ${proposal.unit}. It leaves ${percent(proposal.left)} of the squared error, and half of the days confirm the other half (${percent(proposal.confirmed)}).</p>
    ${proposal.known && html`<p class="quiet">The service has this term already, with the numbers of another fit: yours are found anew.</p>`}
    ${proposal.or.length > 0 && html`<p class="quiet">These data cannot tell it from: ${proposal.or.join('; ')}.</p>`}
    <details><summary>The document</summary><pre tabindex="0">${proposal.toml}</pre></details>
    ${error && html`<p class="note" role="alert">▲ ${error.detail ?? String(error)}.</p>`}
    ${add && html`<p><button class="main" disabled=${busy} onClick=${take}>Add it and refit</button></p>`}
  </article>`;
}
