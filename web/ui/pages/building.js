// The building: its groups as tiles, which rooms lack which effects, and one press for all of them.
import { html, useMemo, useState } from '../html.js';
import { eachPage, useResource, post, withQuery } from '../api.js';
import { address, systemAddress } from '../router.js';
import { useEvents } from '../events.js';
import { usePaced } from '../pace.js';
import { useSystems, refresh, SEVERITY } from '../systems.js';
import { say, sayFault } from '../say.js';
import { fixed, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Table } from '../parts/table.js';
import { Shown, Empty } from '../parts/screens.js';
import { Matrix } from './matrix.js';
import { Adopting, adoption, begin } from './adopting.js';
import { isWithin, placeOf, worstFirst } from './overview-view.js';

/** Names beyond this length do not go into an address: the service takes heads of 16 KiB. */
const LONGEST_NAMES = 8192;

const errorOf = row => (row.size === null ? NONE : `${fixed(row.size)} ${row.quality.unit}`);

/** What a tile shows of the systems in it. */
function tileOf(name, path, rows) {
  const counts = Object.keys(SEVERITY).map(health => [health, rows.filter(row => row.health === health).length]);
  const known = rows.filter(row => row.size !== null);
  const unit = known[0]?.quality.unit;
  // Errors of different units have no mean.
  const own = known.filter(row => row.quality.unit === unit);
  return {
    name,
    path,
    rows,
    counts: counts.filter(([, count]) => count > 0),
    worst: [...rows].sort(worstFirst)[0],
    mean: own.length ? own.reduce((sum, row) => sum + row.size, 0) / own.length : null,
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
  return { tiles: tiles.sort((one, other) => one.name.localeCompare(other.name, 'en', { numeric: true })), here: here.sort(worstFirst) };
}

/** All pages of the matrix: what is known of each effect stands on the first. */
async function wholeMatrix(path, options) {
  const whole = { effects: [], rows: [] };
  const take = ({ effects, items }) => {
    whole.effects = effects ?? whole.effects;
    whole.rows.push(...items);
  };
  await eachPage(path, take, options);
  return whole;
}

/** The matrix with these systems alone, and of its effects what can be said of those. */
function among({ effects, rows }, names) {
  const own = rows.filter(row => names.has(row.system));
  const diagnosed = own.filter(row => row.diagnosis !== null);
  const again = effects.map(effect => {
    const cells = diagnosed.flatMap(row => row.cells.filter(cell => cell.effect === effect.effect));
    const lacking = cells.filter(cell => cell.state === 'named').length;
    const sentence = `${lacking} of ${diagnosed.length} systems ${lacking === 1 ? 'lacks' : 'lack'} ${effect.title}`;
    return { ...effect, lacking, total_saving: null, sentence };
  });
  return { effects: again, rows: own };
}

/** The matrix of the rooms of a group, null before it is known, and how it is asked for. */
function useMatrix(inside, isWhole, isComplete) {
  const names = inside?.map(row => row.system).join() ?? '';
  const isNamed = !isWhole && encodeURIComponent(names).length <= LONGEST_NAMES;
  const path = withQuery('/evidence/matrix', { systems: isNamed ? names : null });
  const matrix = useResource(isWhole || (isComplete && names) ? path : null, { read: wholeMatrix });
  const data = useMemo(
    () => (matrix.data && !isWhole && !isNamed ? among(matrix.data, new Set(names.split(','))) : matrix.data),
    [matrix.data, isWhole, isNamed, names],
  );
  return { matrix: { ...matrix, data }, path, again: usePaced(matrix) };
}

export function Building({ query }) {
  const systems = useSystems();
  const path = query.group ?? '';
  const inside = useMemo(() => systems.rows?.filter(row => isWithin(row, path)) ?? null, [systems.rows, path]);
  const { matrix, path: asked, again } = useMatrix(inside, path === '', systems.complete);
  const [batch, setBatch] = useState(null);
  const [adopting, setAdopting] = useState(adoption);
  useEvents((kind, data) => kind === 'finished' && data.kind === 'diagnose' && again());
  const changed = system => {
    refresh(system);
    again();
  };
  const diagnose = async rooms => {
    try {
      const started = await post('/jobs', { kind: 'diagnose', systems: rooms });
      setBatch(started);
      say(`${started.jobs.length} diagnoses are on their way`);
    } catch (fault) {
      sayFault(fault);
    }
  };
  const empty = html`<${Empty} title="No systems yet"><p>A building shows its rooms here. <a href=${address(['new'])}>Add one</a>, and give it a
    group such as <code>North house/Floor 2</code>.</p></${Empty}>`;
  const top = () => {
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
      ${here.length > 0 && html`<${Rooms} rows=${here} />`}`;
  };
  // Thousands of cells are not drawn again because a job has gone on.
  const bottom = useMemo(
    () => html`<${Shown} of=${matrix} what="what the rooms lack" show=${data => html`<${Matrix} data=${data} query=${query} path=${asked}
      adopt=${adopting ? null : (effect, rooms) => setAdopting(begin(effect, rooms))} />`} />`,
    [matrix.data, matrix.error, query, asked, adopting],
  );
  // What is being adopted goes on, whatever cannot be read meanwhile.
  return html`<${Shown} of=${{ ...systems, data: systems.rows }} what="the rooms" empty=${empty} show=${top} />
    ${adopting && html`<${Adopting} key=${adopting.id} start=${adopting} changed=${changed} close=${() => setAdopting(null)} />`}
    ${inside?.length > 0 && bottom}`;
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
        worst.size === null ? '' : html` <span class="quiet">${errorOf(worst)}</span>`
      }</dd>
    </dl>
  </li>`;
}

function Rooms({ rows }) {
  return html`<${Table} caption="Rooms of this group, worst first" columns=${[['room'], ['health'], ['error', 'number'], ['model']]}
    rows=${rows.map(row => [
      html`<a href=${systemAddress(row.system)}>${row.label || row.system}</a>${row.label ? html` <small class="quiet">${row.system}</small>` : ''}`,
      html`<${Status} of=${row.health} /> <div class="why clamped" title=${row.why}>${row.why}</div>`,
      errorOf(row),
      row.model ?? NONE,
    ])} />`;
}
