// What was done, newest first: by whom, to which system, and why.
import { html } from '../html.js';
import { useResource, withQuery } from '../api.js';
import { useSystems } from '../systems.js';
import { address, setQuery, systemAddress } from '../router.js';
import { clock, fromNow, plainly, words, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Shown, Empty } from '../parts/screens.js';

const SIZE = 50;
const COLUMNS = [['when'], ['who'], ['what'], ['system'], ['which'], ['why']];

export function Audit({ query }) {
  const { rows } = useSystems();
  const path = withQuery('/audit', { system: query.system, page_size: SIZE, page_token: query.page });
  const deeds = useResource(path);
  const known = rows?.map(row => row.system) ?? [];
  const choose = event => setQuery({ system: event.target.value.trim() || null, page: null });
  const empty = html`<${Empty} title=${query.system ? `Nothing was done to ${query.system}` : 'Nothing was done yet'}>
    <p>Whoever changes, deletes or decides something is kept here, with the reason where one is asked for.</p></${Empty}>`;
  return html`
    <div class="row apart"><h1>Who did what</h1>
      <label class="inline">System <input type="search" list="systems" placeholder="all" value=${query.system ?? ''} onChange=${choose} /></label>
      <datalist id="systems">${known.map(system => html`<option value=${system} />`)}</datalist></div>
    <${Shown} of=${deeds} what="what was done" show=${({ items, next_page_token: older }) => html`
      ${items.length === 0 ? empty : html`<${Deeds} items=${items} path=${path} known=${known} />`}
      <p class="row">
        ${query.page && html`<button onClick=${() => setQuery({ page: null }, { replace: false })}>Newest</button>`}
        ${older && html`<button onClick=${() => setQuery({ page: older }, { replace: false })}>Older</button>`}
      </p>`} />`;
}

function Deeds({ items, path, known }) {
  const says = `${items.length} entries, from ${clock(items.at(-1).at)} to ${clock(items[0].at)}`;
  return html`<${Frame} title="Entries" path=${path} drawn=${false} summary=${says}
    note="Who is the name of a token; local is whoever needed none, service what the service did by itself."
    table=${() => ({ columns: COLUMNS, rows: items.map(deed => [deed.at, deed.who, deed.action, deed.system, deed.subject, deed.reason]) })}>
    <${Table} caption=${says} hidden columns=${COLUMNS} rows=${items.map(deed => [
      html`<span class="nowrap" title=${fromNow(deed.at)}>${clock(deed.at)}</span>`,
      deed.who,
      words(deed.action),
      // It may be gone.
      known.includes(deed.system) ? html`<a href=${systemAddress(deed.system)}>${deed.system}</a>` : (deed.system ?? NONE),
      html`<${Subject} deed=${deed} known=${known} />`,
      deed.reason ? plainly(deed.reason) : NONE,
    ])} /></${Frame}>`;
}

/** What it was done to, with the way there. */
function Subject({ deed: { action, system, subject }, known }) {
  if (subject === system) return '';
  const to = { post_model: ['models', subject], post_effect: ['effects', subject], put_schedule: ['schedules'] }[action];
  if (to) return html`<a href=${address(to)}>${subject}</a>`;
  if (subject.startsWith('fit_') && known.includes(system))
    return html`<a href=${systemAddress(system, 'parameters', { fit: subject })}>${subject}</a>`;
  return html`<code>${subject}</code>`;
}
