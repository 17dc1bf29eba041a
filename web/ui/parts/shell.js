// The frame of every page: where one can go, whether the page is live, what has happened.
import { html, useState, useEffect, useErrorBoundary } from '../html.js';
import { address, go } from '../router.js';
import { theme, setTheme } from '../theme.js';
import { useConnection } from '../events.js';
import { REPORT } from '../carried.js';
import { useKeys, actionsNow, CHART_KEYS } from '../keys.js';
import { onSaid } from '../say.js';
import { Commands } from './commands.js';
import { Dialog } from './dialog.js';
import { toggleTable } from './frame.js';
import { Failed } from './screens.js';
import { TokenQuestion, ForgetToken } from './token.js';

const PLACES = REPORT ? [] : [
  ['Overview', [], 'o'],
  ['Building', ['building'], 'b'],
  ['Mornings', ['mornings'], 'n'],
  ['Jobs', ['jobs'], 'j'],
  ['Models and effects', ['models'], 'm'],
  ['Schedules', ['schedules'], 's'],
  ['Who did what', ['audit'], 'a'],
];
const THEMES = { system: ['light', 'Theme: as the system'], light: ['dark', 'Theme: light'], dark: ['system', 'Theme: dark'] };
const SHOWN_MS = 8000;

export function Shell({ place, children }) {
  const [open, setOpen] = useState(null);
  // A dialog says that it is closed a moment later; by then another one may be open.
  const closed = which => () => setOpen(now => (now === which ? null : now));
  const [, redraw] = useState(0);
  // Where the window is narrow, the places are behind a button that says where one is.
  const [menu, setMenu] = useState(false);
  const name = PLACES.find(([, parts]) => (parts[0] ?? 'systems') === (place ?? 'systems'))?.[0];
  const [fault, clear] = useErrorBoundary();
  const live = useConnection();
  useEffect(() => {
    if (fault) clear();
  }, [place]);
  const turnTheme = () => {
    setTheme(THEMES[theme()][0]);
    redraw(count => count + 1);
  };
  useKeys({
    '?': ['show the keys', () => setOpen('help')],
    '.': ['list all commands', () => setOpen('commands')],
    t: ['numbers of the chart that has the focus, or was used last', toggleTable],
    d: ['light, dark, or as the system', turnTheme],
    ...Object.fromEntries(PLACES.map(([name, parts, key]) => [`g ${key}`, [`go to ${name}`, () => go(address(parts))]])),
  });
  return html`
    <a class="skip" href="#main">Skip to the content</a>
    <header class=${menu ? 'open' : ''}>
      <a class="brand" href=${address([])}><span class="glow" aria-hidden="true"></span><span>Lampyris</span></a>
      ${!REPORT && html`<button class="menu" aria-expanded=${menu} aria-controls="pages" onClick=${() => setMenu(!menu)}>☰ ${name ?? 'Pages'}</button>`}
      <nav id="pages" aria-label="Pages" onClick=${() => setMenu(false)}>${PLACES.map(
        ([title, parts]) => html`<a href=${address(parts)} aria-current=${title === name ? 'page' : null}>${title}</a>`,
      )}
        ${!REPORT && html`<a href="/docs">API</a><a href="/docs/book/">Book</a>`}
      </nav>
      <span class="row">
        ${live === false && html`<span class="status bad"><span class="shape" aria-hidden="true">■</span> connection lost, trying again</span>`}
        ${live && html`<span class="status ok" title="Jobs report here as they go"><span class="shape" aria-hidden="true">●</span> live</span>`}
        <${ForgetToken} />
        <button class="plain theme" onClick=${turnTheme}>${THEMES[theme()][1]}</button>
        <button class="plain" onClick=${() => setOpen('commands')} aria-label="Commands">…</button>
        <button class="plain" onClick=${() => setOpen('help')} aria-label="Keys">?</button>
      </span>
    </header>
    <main id="main" tabindex="-1">${fault ? html`<${Failed} error=${fault} retry=${clear} />` : children}</main>
    <${Said} />
    <${TokenQuestion} />
    ${open === 'help' && html`<${Help} close=${closed('help')} />`}
    ${open === 'commands' && html`<${Commands} close=${closed('commands')} />`}`;
}

function Said() {
  const [said, setSaid] = useState(null);
  useEffect(() => onSaid(setSaid), []);
  useEffect(() => {
    const timer = said && setTimeout(() => setSaid(null), SHOWN_MS);
    return () => clearTimeout(timer);
  }, [said]);
  return (
    said &&
    html`<div class="said ${said.fault ? 'fault' : ''}">
    <span>${said.text}</span><button class="plain" aria-label="Close" onClick=${() => setSaid(null)}>✕</button>
  </div>`
  );
}

function Help({ close }) {
  const [keys] = useState(() => actionsNow().map(({ key, meaning }) => [key, meaning]));
  return html`<${Dialog} title="Keys" close=${close}>
    <dl class="keys">${[...keys, ...CHART_KEYS].map(([key, meaning]) => html`<div><dt><kbd>${key}</kbd></dt><dd>${meaning}</dd></div>`)}</dl>
    <p>A word with dots below it says what it means where the pointer rests on it, where the Tab key goes, or when it is touched; Escape takes that
      away.${!REPORT && html` All of them stand in the <a href="/docs/book/reference/glossary.html">glossary</a>.`}</p>
    <p class="row end"><button onClick=${close}>Close</button></p>
  </${Dialog}>`;
}
