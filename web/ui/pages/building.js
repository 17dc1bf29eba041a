// The building: its groups as tiles, which rooms lack which effects, and one press for all of them.
import { html, useEffect, useRef, useState } from '../html.js';
import { ask, useList, useResource, post, withQuery } from '../api.js';
import { address, systemAddress } from '../router.js';
import { useEvents } from '../events.js';
import { say, sayFault } from '../say.js';
import { fixed, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Shown, Empty } from '../parts/screens.js';
import { Matrix } from './matrix.js';
import { Adopting, adoption, begin } from './adopting.js';

const SEVERITY = { bad: 0, attention: 1, unknown: 2, ok: 3 };
/** Lists are asked again once for many ends that come together. */
const TOGETHER_MS = 1000;

/** Where a system is: its group, or what kind it is of. */
const placeOf = row => row.group || row.system.split('/')[0];
const isWithin = (place, path) => path === '' || place === path || place.startsWith(`${path}/`);

/** The first output's error at the horizon of the policy, or of a free run. */
function errorOf(row) {
  const first = Object.values(row.error ?? {})[0];
  return first ? { value: first.ahead ?? first.validation_rmse, unit: first.unit } : null;
}

const worseFirst = (one, other) =>
  SEVERITY[one.health] - SEVERITY[other.health] || (errorOf(other)?.value ?? -1) - (errorOf(one)?.value ?? -1) || one.system.localeCompare(other.system);

/** What a tile shows of the systems in it. */
function tileOf(name, path, rows) {
  const counts = Object.keys(SEVERITY).map(health => [health, rows.filter(row => row.health === health).length]);
  const errors = rows.map(errorOf).filter(error => Number.isFinite(error?.value));
  const unit = errors[0]?.unit;
  // Errors of different units have no mean.
  const own = errors.filter(error => error.unit === unit);
  return {
    name,
    path,
    rows,
    counts: counts.filter(([, count]) => count > 0),
    worst: [...rows].sort(worseFirst)[0],
    mean: own.length ? own.reduce((sum, error) => sum + error.value, 0) / own.length : null,
    unit,
  };
}

/** The groups one level below a path, and the systems that are in none of them. */
function level(rows, path) {
  const groups = new Map();
  const here = [];
  for (const row of rows) {
    const rest = path === '' ? placeOf(row) : placeOf(row).slice(path.length + 1);
    if (rest === '') {
      here.push(row);
      continue;
    }
    const [name] = rest.split('/');
    groups.set(name, [...(groups.get(name) ?? []), row]);
  }
  const tiles = [...groups].map(([name, inside]) => tileOf(name, path === '' ? name : `${path}/${name}`, inside));
  return { tiles: tiles.sort((one, other) => one.name.localeCompare(other.name, 'en', { numeric: true })), here: here.sort(worseFirst) };
}

/** All pages of the matrix: what is known of each effect stands on the first. */
async function wholeMatrix(path, { signal }) {
  const first = await ask(withQuery(path, { page_size: 100 }), { signal });
  const rows = [...first.items];
  for (let token = first.next_page_token; token; ) {
    const page = await ask(withQuery(path, { page_size: 100, page_token: token }), { signal });
    rows.push(...page.items);
    token = page.next_page_token;
  }
  return { effects: first.effects, rows };
}

export function Building({ query }) {
  const systems = useList('/systems');
  const path = query.group ?? '';
  const inside = systems.data?.filter(row => isWithin(placeOf(row), path)) ?? null;
  const names = path === '' ? null : (inside?.map(row => row.system).join() ?? null);
  const isReady = systems.data !== null && (path === '' || names);
  const matrix = useResource(isReady ? withQuery('/evidence/matrix', { systems: names }) : null, { read: wholeMatrix });
  const [batch, setBatch] = useState(null);
  const [adopting, setAdopting] = useState(adoption);
  const timer = useRef(null);
  const refresh = () => {
    clearTimeout(timer.current);
    timer.current = setTimeout(() => [systems, matrix].forEach(list => list.reload()), TOGETHER_MS);
  };
  useEffect(() => () => clearTimeout(timer.current), []);
  useEvents(kind => kind === 'finished' && refresh());
  const diagnose = async rooms => {
    try {
      const started = await post('/jobs', { kind: 'diagnose', systems: rooms });
      setBatch(started);
      say(`${started.jobs.length} diagnoses are on their way`);
    } catch (fault) {
      sayFault(fault);
    }
  };
  const adopt = (effect, rooms) => setAdopting(begin(effect, rooms));
  const empty = html`<${Empty} title="No systems yet"><p>A building shows its rooms here. <a href=${address(['new'])}>Add one</a>, and give it a
    group such as <code>North house/Floor 2</code>.</p></${Empty}>`;
  return html`<${Shown} of=${systems} what="the rooms" empty=${empty} show=${() => {
    const { tiles, here } = level(inside, path);
    const modelled = inside.filter(row => row.model !== null);
    return html`
      <div class="row apart"><h1>Building <span class="quiet">${inside.length}</span></h1>
        <button class="main" disabled=${modelled.length === 0} onClick=${() => diagnose(modelled.map(row => row.system))}>
          Find what is missing in ${modelled.length === 1 ? modelled[0].system : `all ${modelled.length}`}</button></div>
      <${Path} path=${path} />
      ${batch && html`<p role="status"><${Status} of="running" label=${`${batch.jobs.length} diagnoses are on their way.`} /> What they find
        appears here. <a href=${address(['batches', batch.id])}>See how far they are</a></p>`}
      ${inside.length === 0 && html`<${Empty} title="Nothing is in this group"><a href=${address(['building'])}>To the whole building</a></${Empty}>`}
      ${tiles.length > 0 && html`<ul class="tiles">${tiles.map(tile => html`<${Tile} key=${tile.path} tile=${tile} />`)}</ul>`}
      ${here.length > 0 && html`<${Rooms} rows=${here} />`}
      ${adopting && html`<${Adopting} key=${adopting.id} start=${adopting} changed=${refresh} close=${() => setAdopting(null)} />`}
      ${inside.length > 0 && html`<${Shown} of=${matrix} what="what the rooms lack" show=${data =>
        html`<${Matrix} data=${data} query=${query} path=${withQuery('/evidence/matrix', { systems: names })} adopt=${adopting ? null : adopt} />`} />`}`;
  }} />`;
}

/** The way down to a group, each step a link. */
function Path({ path }) {
  const parts = path.split('/').filter(Boolean);
  return html`<nav aria-label="Groups" class="path"><ol>
    <li><a href=${address(['building'])} aria-current=${parts.length === 0 ? 'page' : null}>All</a></li>
    ${parts.map(
      (part, at) => html`<li><a href=${address(['building'], { group: parts.slice(0, at + 1).join('/') })}
      aria-current=${at === parts.length - 1 ? 'page' : null}>${part}</a></li>`,
    )}</ol></nav>`;
}

function Tile({ tile }) {
  const { name, path, rows, counts, worst, mean, unit } = tile;
  const noun = rows.every(row => row.system.startsWith('room/')) ? 'room' : 'system';
  return html`<li class="card tile">
    <h2><a href=${address(['building'], { group: path })}>${name}</a> <span class="quiet">${rows.length} ${noun}${rows.length === 1 ? '' : 's'}</span></h2>
    <p class="row">${counts.map(([health, count]) => html`<${Status} of=${health} label=${`${count} ${health === 'attention' ? 'need attention' : health}`} />`)}</p>
    <dl>
      <dt>mean error</dt><dd>${mean === null ? NONE : `${fixed(mean)} ${unit}`}</dd>
      <dt>worst</dt><dd><a href=${systemAddress(worst.system)} title=${worst.why}>${worst.system}</a>${
        errorOf(worst) ? html` <span class="quiet">${fixed(errorOf(worst).value)} ${errorOf(worst).unit}</span>` : ''
      }</dd>
    </dl>
  </li>`;
}

function Rooms({ rows }) {
  return html`<${Table} caption="Rooms of this group, worst first" columns=${[['room'], ['health'], ['error', 'number'], ['model']]}
    rows=${rows.map(row => [
      html`<a href=${systemAddress(row.system)}>${row.label || row.system}</a>${row.label ? html` <small class="quiet">${row.system}</small>` : ''}`,
      html`<${Status} of=${row.health} /> <div class="why clamped" title=${row.why}>${row.why}</div>`,
      errorOf(row) ? `${fixed(errorOf(row).value)} ${errorOf(row).unit}` : NONE,
      row.model ?? NONE,
    ])} />`;
}
