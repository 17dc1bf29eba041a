// Empty, loading and failed are three different things, and look it.
import { html, useState, useEffect } from '../html.js';

/** Grey bars at once, a sentence after 300 ms. */
export function Loading({ what }) {
  const [slow, setSlow] = useState(false);
  useEffect(() => {
    const timer = setTimeout(() => setSlow(true), 300);
    return () => clearTimeout(timer);
  }, []);
  return html`<div class="screen loading" aria-busy="true">
    <div class="bars" aria-hidden="true"><i></i><i></i><i></i></div>
    <p>${slow ? `Loading ${what} …` : ' '}</p>
  </div>`;
}

/** What the service said, every fault of it, and a way to ask again. */
export function Failed({ error, retry }) {
  return html`<div class="screen failed" role="alert">
    <h3><span aria-hidden="true">■</span> ${error.title ?? 'This page has a fault'}</h3>
    ${!error.errors?.length && html`<p>${error.detail ?? error.message}</p>`}
    <${Faults} errors=${error.errors} />
    ${retry && html`<button onClick=${retry}>Try again</button>`}
  </div>`;
}

/**
 * Why something was not saved. Where somebody else was first, it says what to do, which are the children, and `again`
 * looks at what is there now.
 */
export function NotSaved({ error, word = 'See what is there now', again, children }) {
  if (error.type !== 'not-as-expected') return html`<${Failed} error=${error} />`;
  return html`<div class="screen failed" role="alert">
    <h3><span aria-hidden="true">■</span> Nothing was saved</h3>
    ${children}
    ${again && html`<button type="button" onClick=${again}>${word}</button>`}
  </div>`;
}

export function Faults({ errors = [] }) {
  if (errors.length === 0) return null;
  return html`<ul class="faults">${errors.map(
    fault => html`<li>
    <code>${fault.pointer}</code> ${fault.detail}${fault.suggestion ? html` <em>${fault.suggestion}</em>` : ''}
  </li>`,
  )}</ul>`;
}

/** Nothing is there yet: why, and what to do about it. */
export function Empty({ title, children }) {
  return html`<div class="screen empty"><h3><span aria-hidden="true">○</span> ${title}</h3>${children}</div>`;
}

/** One of the three, or what `show` makes of the data. */
export function Shown({ of, what, empty, show }) {
  if (of.error) return html`<${Failed} error=${of.error} retry=${of.reload} />`;
  if (of.data === null) return html`<${Loading} what=${what} />`;
  if (empty && Array.isArray(of.data) && of.data.length === 0) return empty;
  return show(of.data);
}
