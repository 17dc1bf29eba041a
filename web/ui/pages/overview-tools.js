// What stands above the table: what is shown of it, filters that are kept by name, and the group of one or many systems.
import { html, useState } from '../html.js';
import { ask, putSystem } from '../api.js';
import { setQuery, go, address } from '../router.js';
import { say } from '../say.js';
import { number, words } from '../format.js';
import { Dialog } from '../parts/dialog.js';
import { NotSaved } from '../parts/screens.js';
import { refresh } from '../systems.js';
import { GROUPINGS, PAGE_SIZE } from './overview-view.js';

const SAVED = 'lampyris-filters';
const DENSITY = 'lampyris-density';

function stored(key, otherwise) {
  try {
    return JSON.parse(localStorage.getItem(key)) ?? otherwise;
  } catch {
    return otherwise;
  }
}

function store(key, value) {
  try {
    localStorage.setItem(key, JSON.stringify(value));
  } catch {
    // Without a store of the browser it lasts as long as the page.
  }
}

/** How close the rows stand: as the address says, or as it was chosen last. */
export const density = query => query.density ?? stored(DENSITY, 'comfortable');

/** What of the address is the filter: not where one is in it. */
const filterOf = ({ page: _, open: __, ...rest }) => new URLSearchParams(Object.entries(rest).sort()).toString();

function SavedFilters({ query }) {
  const [saved, setSaved] = useState(() => stored(SAVED, []));
  const [naming, setNaming] = useState(false);
  const now = filterOf(query);
  const current = saved.find(one => one.query === now);
  const keep = list => {
    store(SAVED, list);
    setSaved(list);
  };
  const choose = name => {
    const one = saved.find(entry => entry.name === name);
    go(one ? `${address([])}?${one.query}` : address([]));
  };
  const save = event => {
    event.preventDefault();
    const name = new FormData(event.target).get('name').trim();
    if (!name) return;
    keep([...saved.filter(one => one.name !== name), { name, query: now }].sort((a, b) => a.name.localeCompare(b.name)));
    setNaming(false);
  };
  return html`
    ${saved.length > 0 && html`<label class="inline">Filter <select aria-label="Saved filter" value=${current?.name ?? ''} onChange=${event => choose(event.target.value)}>
      <option value="">${now && !current ? 'not saved' : 'all systems'}</option>
      ${saved.map(({ name }) => html`<option value=${name} selected=${name === current?.name}>${name}</option>`)}</select></label>`}
    ${now && !current && html`<button class="plain" onClick=${() => setNaming(true)}>Save this filter</button>`}
    ${current && html`<button class="plain" onClick=${() => keep(saved.filter(one => one !== current))}>Forget ${current.name}</button>`}
    ${naming && html`<${Dialog} title="Save this filter" close=${() => setNaming(false)}><form onSubmit=${save}>
      <p>What is searched, filtered, sorted and grouped now is kept in this browser. Its address can be sent to others.</p>
      <label>Name<input name="name" required maxlength="60" autofocus /></label>
      <p class="row end"><button type="button" onClick=${() => setNaming(false)}>Leave it</button><button class="main">Save it</button></p>
    </form></${Dialog}>`}`;
}

/** Steps through the pages; `count` entries are there. */
export function Pages({ page, count }) {
  const pages = Math.max(Math.ceil(count / PAGE_SIZE), 1);
  if (pages === 1) return null;
  const to = next => setQuery({ page: next === 1 ? null : next });
  return html`<span class="row" role="group" aria-label="Pages of the table">
    <button disabled=${page === 1} aria-label="Page before" onClick=${() => to(page - 1)}>‹</button>
    <span>lines ${number((page - 1) * PAGE_SIZE + 1, 6)} to ${number(Math.min(page * PAGE_SIZE, count), 6)} of ${number(count, 6)}</span>
    <button disabled=${page === pages} aria-label="Next page" onClick=${() => to(page + 1)}>›</button>
  </span>`;
}

/** The second line of the head: filters, grouping, density, pages. */
export function Tools({ query, page, count, chosen, regroup, complete }) {
  const dense = density(query);
  const turn = () => {
    const other = dense === 'compact' ? 'comfortable' : 'compact';
    store(DENSITY, other);
    setQuery({ density: other });
  };
  const chip = (name, says) =>
    query[name] && html`<button aria-label=${`No longer only ${says}`} onClick=${() => setQuery({ [name]: null, page: null })}>${says} ✕</button>`;
  return html`<div class="row apart tools">
    <span class="row">
      <label class="inline">Group by <select value=${query.by ?? ''} onChange=${event => setQuery({ by: event.target.value, page: null, open: null })}>
        <option value="">nothing</option>
        ${GROUPINGS.map(([name, title]) => html`<option value=${name} selected=${name === query.by}>${title.toLowerCase()}</option>`)}</select></label>
      ${chip('in', query.in)}${chip('next', words(query.next ?? ''))}
      <${SavedFilters} query=${query} />
      <button class="plain" aria-pressed=${dense === 'compact'} onClick=${turn}>Compact rows</button>
      ${chosen.size > 0 && html`<button class="plain" onClick=${regroup}>Change the group of ${chosen.size} selected</button>`}
      ${!complete && html`<span class="quiet" role="status">More systems are being read …</span>`}
    </span>
    <${Pages} page=${page} count=${count} />
  </div>`;
}

/** Asks for the group of systems and writes it into their documents, each as it is by now. */
export function Regroup({ rows, groups, close }) {
  const [group, setGroup] = useState(rows[0].group);
  const [error, setError] = useState(null);
  const [left, setLeft] = useState(null);
  const save = async event => {
    event.preventDefault();
    setError(null);
    try {
      for (const [at, { system }] of rows.entries()) {
        setLeft(rows.length - at);
        const seen = await ask(`/systems/${system}`);
        await putSystem(seen, { ...seen, group: group.trim() });
        refresh(system);
      }
      say(`${rows.length === 1 ? rows[0].system : `${rows.length} systems`}: ${group.trim() ? `in ${group.trim()}` : 'in no group'}`);
      close();
    } catch (fault) {
      setError(fault);
      setLeft(null);
    }
  };
  return html`<${Dialog} title=${rows.length === 1 ? `Group of ${rows[0].system}` : `Group of ${rows.length} systems`} close=${close}>
    <form onSubmit=${save}>
      <p>Where people look for ${rows.length === 1 ? 'it' : 'them'}: a building, a floor, a line. Levels have / between them, as in North house/Floor 2.</p>
      <label>Group<input value=${group} maxlength="200" list="groups" autofocus onInput=${event => setGroup(event.target.value)} /></label>
      <datalist id="groups">${groups.map(name => html`<option value=${name} />`)}</datalist>
      ${error && html`<${NotSaved} error=${error}><p>Somebody has changed it at the same moment. Save again.</p></${NotSaved}>`}
      <p class="row end"><button type="button" onClick=${close}>Leave it</button><button class="main" disabled=${left !== null}>${
        left !== null && rows.length > 1 ? `${left} left …` : 'Save'
      }</button></p>
    </form></${Dialog}>`;
}

