// Questions that must be answered before something happens. The browser keeps the focus inside, and Escape closes.
import { html, useEffect, useRef, useState } from '../html.js';
import { post } from '../api.js';
import { say } from '../say.js';
import { Failed } from './screens.js';

export function Dialog({ title, close, children }) {
  const dialog = useRef(null);
  useEffect(() => {
    // Where the focus was, it is again: a dialog that is taken away does not give it back by itself.
    const before = document.activeElement;
    dialog.current.showModal();
    return () => before?.focus();
  }, []);
  return html`<dialog ref=${dialog} onClose=${close} aria-label=${title}>
    <h2>${title}</h2>
    ${children}
  </dialog>`;
}

/** Asks for a reason and then does it: `act(reason)` is a promise. */
export function Reason({ title, text, word, act, close }) {
  const [reason, setReason] = useState('');
  const [error, setError] = useState(null);
  const [busy, setBusy] = useState(false);
  const submit = async event => {
    event.preventDefault();
    setBusy(true);
    try {
      await act(reason.trim());
      close();
    } catch (fault) {
      setError(fault);
      setBusy(false);
    }
  };
  return html`<${Dialog} title=${title} close=${close}>
    <form onSubmit=${submit}>
      <p>${text}</p>
      <label>Reason, for whoever reads this later
        <input value=${reason} required maxlength="500" autofocus onInput=${event => setReason(event.target.value)} /></label>
      ${error && html`<${Failed} error=${error} />`}
      <p class="row end">
        <button type="button" onClick=${close}>Leave it</button>
        <button class="main" disabled=${busy}>${word}</button>
      </p>
    </form>
  </${Dialog}>`;
}

/** What `Reason` asks before a fit is promoted or rejected, which is the `word`; `done` hears that it was. */
export const decision = (fit, word, { title, text, done }) => ({
  title,
  text,
  word: title.split(' ')[0],
  act: reason =>
    post(`/fits/${fit.id}/${word}`, { reason }).then(() => {
      say(`${title}: done`);
      done();
    }),
});
