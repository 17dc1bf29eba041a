// Asks for the token where the service wants one, and lets go of it.
import { html, useEffect, useState } from '../html.js';
import { token, tokenQuestion, onTokenQuestion, setToken, leaveToken } from '../token.js';
import { say } from '../say.js';
import { Dialog } from './dialog.js';

export function TokenQuestion() {
  const [asked, setAsked] = useState(tokenQuestion);
  useEffect(() => {
    // It may have come up since this was drawn.
    setAsked(tokenQuestion());
    return onTokenQuestion(() => setAsked(tokenQuestion()));
  }, []);
  const submit = event => {
    event.preventDefault();
    const text = new FormData(event.target).get('token').trim();
    if (text) setToken(text);
  };
  return (
    asked &&
    html`<${Dialog} title="This service wants a token" close=${leaveToken}>
    <form onSubmit=${submit}>
      ${asked.token && html`<p role="alert">It was refused: ${asked.problem.detail}.</p>`}
      <p>Whoever runs the service makes one with <code>lampyris token create</code>. It is kept until this tab is closed.</p>
      <label>Token
        <input name="token" type="password" required autofocus autocomplete="off" spellcheck="false" /></label>
      <p class="row end">
        <button type="button" onClick=${leaveToken}>Leave it</button>
        <button class="main">Go on</button>
      </p>
    </form>
  </${Dialog}>`
  );
}

/** Lets go of the token, where there is one. */
export function ForgetToken() {
  const [held, setHeld] = useState(token);
  useEffect(() => onTokenQuestion(() => setHeld(token())), []);
  const forget = () => {
    setToken(null);
    say('The token is forgotten');
  };
  return held && html`<button class="plain" onClick=${forget}>Forget the token</button>`;
}
