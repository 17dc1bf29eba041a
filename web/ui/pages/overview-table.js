// The table of the overview: a row for each system, and the heads of groups.
import { html } from '../html.js';
import { systemAddress, setQuery } from '../router.js';
import { NONE, length, fixed, fromNow, clock, horizon, plainly, words } from '../format.js';
import { Status, Flags } from '../parts/status.js';
import { Spark } from '../charts/spark.js';
import { needsSomebody, SEVERITY } from '../systems.js';
import { COLUMNS, placeOf, toggledIn } from './overview-view.js';

/** A text whose long names may be broken at their underscores. */
const breakable = text => text.split(/(?<=_)/).map((part, at) => (at ? html`<wbr />${part}` : part));

/** The next press turns the order round, and the third gives the worst first again. */
const turned = (sort, name) => (sort === name ? `-${name}` : sort === `-${name}` ? null : name);

function Head({ sort, all, some, count, chooseAll }) {
  const direction = name => (sort === name ? 'ascending' : sort === `-${name}` ? 'descending' : 'none');
  return html`<thead role="rowgroup"><tr role="row">
    <th role="columnheader" scope="col"><input type="checkbox" aria-label=${`Select all ${count} that match`} checked=${all} indeterminate=${some && !all}
      onChange=${event => chooseAll(event.target.checked)} /></th>
    ${COLUMNS.map(
      ([name, title, , kind]) => html`<th role="columnheader" scope="col" class=${kind} aria-sort=${direction(name)}><button class="sort"
        title="Sort by it; a second press turns the order round, a third one shows the worst first"
        onClick=${() => setQuery({ sort: turned(sort, name), page: null })}>${title}<span aria-hidden="true">${
          { ascending: ' ▲', descending: ' ▼', none: '' }[direction(name)]
        }</span></button></th>`,
    )}
  </tr></thead>`;
}

/** What a group is, how its members fare, and what can be done for all of them. */
function GroupHead({ line, open, actions, current, setAt }) {
  const { head, says, rows, isClosed, next, by } = line;
  const counts = Object.keys(SEVERITY)
    .map(health => [health, rows.filter(row => row.health === health).length])
    .filter(([, count]) => count > 0);
  const names = rows.map(row => row.system);
  const [word, act] = (next && actions[next.code]) ?? [];
  return html`<tr role="row" class="group" aria-current=${current ? 'true' : null}>
    <th role="rowheader" scope="rowgroup" colspan=${COLUMNS.length + 1}><span class="row">
      <button class="plain fold" aria-expanded=${!isClosed} onFocus=${() => setAt(head)}
        onClick=${() => setQuery({ open: toggledIn(open, head) })}><span aria-hidden="true">${isClosed ? '▸' : '▾'}</span> ${says}</button>
      ${by !== 'health' && counts.map(([health, count]) => html`<${Status} of=${health} label=${counts.length > 1 ? `${count} ${health}` : health} />`)}
      <button class="plain" onClick=${() => actions.choose(names)}>Select ${rows.length === 1 ? 'it' : `all ${rows.length}`}</button>
      ${act && html`<button onClick=${() => act(names)}>${word} ${rows.length === 1 ? 'it' : `all ${rows.length}`}</button>`}
    </span></th>
  </tr>`;
}

/** The error by which a system is judged, with what holding the last measurement would do. */
function ErrorCell({ row }) {
  const { quality } = row;
  if (!quality || row.size === null) return html`<td role="cell" data-label="Error" class="number">${NONE}</td>`;
  const ahead = quality.ahead !== null;
  const of = quality.outputs > 1 ? ` of ${quality.output}` : '';
  const what = ahead ? `${horizon(quality.horizon)} ahead${of}` : `free run${of}`;
  const beside = ahead ? ` Holding the last measurement errs by ${fixed(quality.persistence)} ${quality.unit}.` : '';
  const noise = quality.rho === null ? '' : ` Left to itself, the model errs ${quality.rho.toFixed(1)} times as much as noise would.`;
  return html`<td role="cell" data-label="Error" class="number" title=${`Root mean square error, ${what}, on measurements that the search has not seen.${beside}${noise}`}>
    ${fixed(row.size)} ${quality.unit}<small>${what}</small>${row.status === null && html`<small>newest fit</small>`}</td>`;
}

/** The errors of the last fits; of several outputs those of the first. */
function TrendCell({ row }) {
  if (!row.trend?.length) return html`<td role="cell" data-label="Validation">${NONE}</td>`;
  const [output, { unit }] = Object.entries(row.error)[0] ?? [row.quality.output, row.quality];
  return html`<td role="cell" data-label="Validation"><${Spark} values=${row.trend} unit=${unit} /><small>last ${fixed(row.trend.at(-1))} ${unit}${
    row.quality?.outputs > 1 ? ` of ${output}` : ''
  }</small></td>`;
}

function SystemRow({ row, current, chosen, toggle, setAt, running, refit, regroup, run }) {
  const is = running ?? { queued: 'waits', running: 'runs' }[row.latest_state];
  const group = placeOf(row);
  return html`<tr role="row" class=${chosen ? 'chosen' : ''} aria-current=${current ? 'true' : null}>
    <td role="cell"><input type="checkbox" aria-label=${`Select ${row.system}`} checked=${chosen} onChange=${() => toggle(row.system)} /></td>
    <th role="rowheader" scope="row" class="name"><a href=${systemAddress(row.system)} onFocus=${() => setAt(row.system)}>${row.system}</a><small
      title=${row.label}>${row.label || row.model}</small><small class="where"><button class="plain in" title=${`Show only ${group}`}
      onClick=${() => setQuery({ in: group, page: null })}>${group}</button><button class="plain in" title="Change the group"
      aria-label=${`Change the group of ${row.system}`} onClick=${() => regroup([row])}>✎</button></small></th>
    <td role="cell" data-label="Health"><span class="nowrap state"><${Status} of=${row.health} help="quiet" />${
      needsSomebody(row) && html` <a class="next" href=${row.next.href}>${row.next.text}</a>`
    }</span><div class="why clamped" title=${row.why}>${breakable(plainly(row.why))}</div></td>
    <td role="cell" data-label="Served" class="nowrap"><${Status} of=${row.status ?? 'none'} help="quiet" /><small>
      ${row.revision === null ? 'no revision' : `revision ${row.revision}, ${length(row.age_s)} old`}</small></td>
    <${ErrorCell} row=${row} />
    <${TrendCell} row=${row} />
    <td role="cell" data-label="Fails most"><div class="regime clamped" title=${row.worst_regime ?? ''}>${row.worst_regime ?? NONE}</div></td>
    <td role="cell" data-label="Flags">${row.flags.length ? html`<${Flags} of=${row.flags} most=${1} />` : NONE}</td>
    <td role="cell" data-label="Newest sample" class="nowrap">${row.measured_to ? html`<span title=${clock(row.measured_to)}>${fromNow(row.measured_to)}</span>` : NONE}</td>
    <td role="cell" data-label="Next fit" class="nowrap">${
      is
        ? html`<${Status} of=${is === 'waits' ? 'queued' : 'running'} label=${is} />`
        : html`<button class="plain" aria-label=${`Refit ${row.system}`} onClick=${() => refit([row.system])}>Refit</button>`
    }<small title=${run ? clock(run) : ''}>${run ? fromNow(run) : 'no schedule'}</small></td>
  </tr>`;
}

/**
 * `shown` are the lines of this page, `count` systems match, on all pages together; `at` names the line where the keyboard is; `actions` are what can be done for many,
 * by the code of the next step.
 */
export function SystemsTable({ shown, at, setAt, query, chosen, toggle, all, count, chooseAll, running, refit, regroup, nextRun, actions, table, compact }) {
  const caption = query.sort ? `Systems by ${words(query.sort.replace('-', ''))}` : 'Systems, worst first';
  return html`<div class="scroll" tabindex="0" role="region" aria-label=${caption}><table role="table" class=${`systems cards ${compact ? 'compact' : ''}`} ref=${table}>
    <caption role="caption" class="unseen">${caption}</caption>
    <${Head} sort=${query.sort} all=${all} some=${chosen.size > 0} count=${count} chooseAll=${chooseAll} />
    <tbody role="rowgroup">${shown.map(line =>
      line.head
        ? html`<${GroupHead} key=${line.head} line=${line} open=${query.open} actions=${actions} current=${line.head === at} setAt=${setAt} />`
        : html`<${SystemRow} key=${line.system} row=${line} current=${line.system === at} chosen=${chosen.has(line.system)} toggle=${toggle}
            setAt=${setAt} running=${running.get(line.system)} refit=${refit} regroup=${regroup} run=${nextRun(line)} />`,
    )}</tbody>
  </table></div>`;
}
