// Which page an address is.
import { html, render, useEffect, useRef } from './html.js';
import { useHere, keptPlace } from './router.js';
import { start } from './events.js';
import { Shell } from './parts/shell.js';
import { Empty } from './parts/screens.js';
import { Overview } from './pages/overview.js';
import { SystemPage } from './pages/system.js';
import { Jobs } from './pages/jobs.js';
import { later } from './parts/later.js';

const NewSystem = later(() => import('./pages/new.js'), 'NewSystem');
const JobPage = later(() => import('./pages/job.js'), 'JobPage');
const BatchPage = later(() => import('./pages/batch.js'), 'BatchPage');
const Models = later(() => import('./pages/models.js'), 'Models');
const ModelPage = later(() => import('./pages/model.js'), 'ModelPage');
const EffectPage = later(() => import('./pages/model.js'), 'EffectPage');
const Editor = later(() => import('./pages/editor.js'), 'Editor');
const Schedules = later(() => import('./pages/schedules.js'), 'Schedules');
const Audit = later(() => import('./pages/audit.js'), 'Audit');
const Neighbours = later(() => import('./pages/neighbours.js'), 'Neighbours');
const Building = later(() => import('./pages/building.js'), 'Building');
const Mornings = later(() => import('./pages/mornings.js'), 'Mornings');
const Morning = later(() => import('./pages/mornings.js'), 'Morning');

function page(parts, query) {
  const [place, first, second, third] = parts;
  if (place === undefined) return html`<${Overview} query=${query} />`;
  if (place === 'new') return html`<${NewSystem} />`;
  if (place === 'systems' && second) {
    const system = `${first}/${second}`;
    return html`<${SystemPage} key=${system} system=${system} tab=${third ?? 'fit'} query=${query} />`;
  }
  if (place === 'jobs') return first ? html`<${JobPage} key=${first} id=${first} />` : html`<${Jobs} query=${query} />`;
  if (place === 'batches' && first) return html`<${BatchPage} key=${first} id=${first} />`;
  if (place === 'edit') return html`<${Editor} key=${first} kind=${first} query=${query} />`;
  if (place === 'models') return first ? html`<${ModelPage} key=${first} id=${first} />` : html`<${Models} />`;
  if (place === 'effects' && first) return html`<${EffectPage} key=${first} id=${first} />`;
  if (place === 'schedules') return html`<${Schedules} />`;
  if (place === 'audit') return html`<${Audit} query=${query} />`;
  if (place === 'building') return html`<${Building} query=${query} />`;
  if (place === 'mornings') return first ? html`<${Morning} key=${first} id=${first} />` : html`<${Mornings} />`;
  if (place === 'neighbours') return html`<${Neighbours} query=${query} />`;
  return html`<${Empty} title="There is no such page"><p><a href="/ui/">To the overview</a></p></${Empty}>`;
}

/** Under which place of the navigation a page is that has none of its own. */
const BELOW = { edit: 'models', effects: 'models', batches: 'jobs', new: 'systems', neighbours: 'systems' };

function App() {
  const { parts, query } = useHere();
  const path = parts.join('/');
  const first = useRef(true);
  useEffect(() => {
    // After a step to another page the keyboard and the screen reader begin at its content; a tab keeps them, and a page that
    // knows where somebody was leads them there.
    if (!first.current && !keptPlace()?.line && !document.activeElement?.closest('[role=tablist]'))
      document.getElementById('main').focus({ preventScroll: true });
    first.current = false;
    document.title = parts.length ? `${parts.slice(0, 4).join(' ')} · Lampyris` : 'Lampyris';
  }, [path]);
  const place = BELOW[parts[0]] ?? parts[0];
  return html`<${Shell} place=${place}>${page(parts, query)}</${Shell}>`;
}

start();
render(html`<${App} />`, document.getElementById('page'));
