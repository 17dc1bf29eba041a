// Everything that can be done here, found by typing.
import { html, useState, useId, useEffect, useRef } from '../html.js';
import { systemAddress, go } from '../router.js';
import { useSystems } from '../systems.js';
import { actionsNow } from '../keys.js';
import { Dialog } from './dialog.js';

const matches = (text, typed) => typed.toLowerCase().split(/\s+/).every(word => text.toLowerCase().includes(word));

export function Commands({ close }) {
  const [actions] = useState(() => actionsNow().filter(({ key }) => key !== '.'));
  const [typed, setTyped] = useState('');
  const [at, setAt] = useState(0);
  const { rows } = useSystems();
  const id = useId();
  const list = useRef(null);
  const places = (rows ?? []).map(({ system, label }) => ({
    key: '',
    meaning: `open ${system}${label ? `, ${label}` : ''}`,
    act: () => go(systemAddress(system)),
  }));
  const shown = [...actions, ...places].filter(({ key, meaning }) => matches(`${meaning} ${key}`, typed));
  const chosen = Math.min(at, shown.length - 1);
  useEffect(() => list.current.querySelector('[aria-selected=true]')?.scrollIntoView({ block: 'nearest' }), [chosen]);
  const run = action => {
    close();
    action.act();
  };
  const onKeyDown = event => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (step) setAt((chosen + step + shown.length) % Math.max(shown.length, 1));
    else if (event.key !== 'Enter') return;
    else if (shown.length) run(shown[chosen]);
    event.preventDefault();
  };
  return html`<${Dialog} title="Commands" close=${close}>
    <input class="wide" autofocus role="combobox" aria-label="What is to be done" aria-expanded="true" aria-controls=${id}
      aria-activedescendant=${shown.length ? `${id}-${chosen}` : null} placeholder="Type a part of its name" value=${typed}
      onInput=${event => {
        setTyped(event.target.value);
        setAt(0);
      }} onKeyDown=${onKeyDown} />
    <ul class="commands" role="listbox" id=${id} aria-label="Commands" ref=${list}>${shown.map(
      (action, index) => html`<li role="option" id=${`${id}-${index}`} aria-selected=${index === chosen} onClick=${() => run(action)}>
        <span>${action.meaning}</span>${action.key && html`<kbd>${action.key}</kbd>`}</li>`,
    )}</ul>
    ${shown.length === 0 && html`<p class="quiet">Nothing here is called so.</p>`}
  </${Dialog}>`;
}
