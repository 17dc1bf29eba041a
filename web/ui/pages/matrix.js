// Every effect beside every room: what is missing, what is suspected, what the data cannot show.
import { html, useRef, useState } from '../html.js';
import { address, systemAddress, setQuery } from '../router.js';
import { fixed, number, sentence, NOISE, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Empty } from '../parts/screens.js';

/** Each state as a shape, a word, and what the legend says of it; colour only repeats them. */
const STATES = {
  named: ['■', 'missing', 'is missing, with what adding it saves'],
  suspected: ['▲', 'suspected', 'suspected, with its t over all windows'],
  in_model: ['●', 'in the model', 'in the model'],
  absent: ['·', 'not seen', 'looked for and not seen'],
  not_testable: ['?', 'not testable', 'cannot be seen with these data'],
};
/** Shades of what is missing, by the share of the largest saving. */
const SHADES = 4;
/** Rows that are drawn at once. */
const ROWS = 200;

const cellOf = (row, effect) => row.cells.find(cell => cell.effect === effect) ?? null;
/** Effects of which something is to be seen: the others only fill the table. */
const isSeen = (effect, rows) => rows.some(row => ['named', 'suspected', 'in_model'].includes(cellOf(row, effect)?.state));

function textOf(cell) {
  if (cell.state === 'named') return cell.saving === null ? '' : `${fixed(cell.saving)} ${cell.unit ?? NOISE}`;
  return cell.state === 'suspected' ? number(cell.t, 2) : '';
}

/** The largest saving of each unit. */
function largestSavings(rows) {
  const most = new Map();
  for (const { saving, unit } of rows.flatMap(row => row.cells)) most.set(unit, Math.max(most.get(unit) ?? 0.01, saving ?? 0));
  return most;
}

/** What rooms lack first, the largest saving first. */
const savingOf = row => row.cells.reduce((sum, cell) => sum + Math.max(cell.saving ?? 0, 0), 0);

export function Matrix({ data, query, path, adopt }) {
  // Rows and effects move while one looks at them: the place is what stands there.
  const [at, setAt] = useState({ system: null, effect: null });
  const [all, setAll] = useState(false);
  const table = useRef(null);
  const known = data.rows.filter(row => row.diagnosis !== null);
  const unseen = data.rows.length - known.length;
  if (known.length === 0)
    return html`<${Empty} title="Nobody has looked yet what is missing"><p>One press above looks into every room of this group, and what it
      finds stands here: each effect beside each room, and what adding it would save.</p></${Empty}>`;
  const lacked = data.effects.filter(effect => effect.lacking > 0);
  const effects = data.effects.filter(effect => all || isSeen(effect.effect, known));
  const hidden = data.effects.length - data.effects.filter(effect => isSeen(effect.effect, known)).length;
  const rows = [...known].sort((one, other) => savingOf(other) - savingOf(one) || one.system.localeCompare(other.system)).slice(0, ROWS);
  const most = largestSavings(known);
  const row = Math.max(rows.findIndex(entry => entry.system === at.system), 0);
  const column = Math.max(effects.findIndex(entry => entry.effect === at.effect), 0);
  const move = (event, step) => {
    event.preventDefault();
    const next = [Math.min(Math.max(row + step[0], 0), rows.length - 1), Math.min(Math.max(column + step[1], 0), effects.length - 1)];
    table.current.querySelector(`[data-at="${next.join()}"]`)?.focus();
  };
  const keys = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1], Home: [0, -1e6], End: [0, 1e6], PageUp: [-10, 0], PageDown: [10, 0] };
  const pressed = event => keys[event.key] && !event.altKey && !event.ctrlKey && !event.metaKey && move(event, keys[event.key]);
  const here = rows[row] && effects[column] ? cellOf(rows[row], effects[column].effect) : null;
  const summary = lacked.length ? `${lacked[0].sentence}.` : 'No room lacks an effect that has a name.';
  return html`
    <h2>What the rooms lack</h2>
    ${lacked.length === 0 && html`<p>No diagnosed room lacks an effect that has a name.</p>`}
    ${lacked.length > 0 && html`<ul class="lacked">${lacked.map(effect => html`<${Lacked} key=${effect.effect} effect=${effect} rows=${known}
      marked=${query.effect === effect.effect} adopt=${adopt} />`)}</ul>`}
    ${unseen > 0 && html`<p class="note">▲ ${unseen} of ${data.rows.length} rooms were never diagnosed: nothing is known of them.</p>`}
    <${Frame} title="Effects and rooms" path=${path} drawn=${false} summary=${summary} table=${() => numbers(known)}
      note=${`Arrow keys walk from cell to cell, Enter opens what the room is missing. ${rows.length < known.length ? `The ${ROWS} rooms that lack most are drawn; the table has all ${known.length}.` : ''}`}>
      <div class="scroll matrix" ref=${table}><table role="grid" onKeyDown=${pressed}>
        <caption class="unseen">Effects beside rooms</caption>
        <thead><tr><th scope="col" class="corner">room</th>${effects.map(effect => html`<th scope="col" class=${query.effect === effect.effect ? 'marked' : ''}
          title=${effect.sentence}><span>${effect.title}</span></th>`)}</tr></thead>
        <tbody>${rows.map((entry, y) => html`<tr key=${entry.system}><th scope="row"><a tabindex="-1" href=${systemAddress(entry.system, 'missing')}>${entry.system}</a></th>
          ${effects.map((effect, x) => html`<${Cell} key=${effect.effect} cell=${cellOf(entry, effect.effect)} system=${entry.system} effect=${effect}
            place=${`${y},${x}`} most=${most} current=${y === row && x === column} focus=${() => setAt({ system: entry.system, effect: effect.effect })} />`)}</tr>`)}</tbody>
      </table></div>
      <p class="says" aria-hidden="true">${rows[row] && effects[column] ? html`<b>${rows[row].system}, ${effects[column].title}:</b> ${here?.why ?? 'It was not tried.'}` : ' '}</p>
      <p class="legend marks">${Object.entries(STATES).map(([state, [shape, , says]]) => html`<span><span class="mark ${state}" aria-hidden="true">${shape}</span> ${says}</span>`)}</p>
      ${hidden > 0 && html`<label class="inline"><input type="checkbox" checked=${all} onChange=${() => setAll(!all)} /> Show also ${hidden} effects that
        no room shows</label>`}
    </${Frame}>`;
}

function Lacked({ effect, rows, marked, adopt }) {
  const lacking = rows.filter(row => cellOf(row, effect.effect)?.state === 'named');
  const start = () =>
    adopt(
      effect,
      lacking.map(row => ({ system: row.system, diagnosis: row.diagnosis, members: cellOf(row, effect.effect).members })),
    );
  return html`<li class="card ${marked ? 'marked' : ''}">
    <div class="row apart"><p><b>${effect.title}.</b> ${sentence(effect.sentence)}.
      ${effect.total_saving > 0 && html` <span class="quiet">Together ${fixed(effect.total_saving)} ${effect.unit ?? NOISE}.</span>`}</p>
      <span class="row"><button class="plain" aria-pressed=${marked} aria-label=${`Mark ${effect.title}`} onClick=${() => setQuery({ effect: marked ? null : effect.effect })}>Mark</button>
        <a class="button" href=${address(['effects', effect.effect])} aria-label=${`What it is: ${effect.title}`}>What it is</a>
        ${adopt && html`<button class="main" onClick=${start}>Try it in ${lacking.length === 1 ? lacking[0].system : `${lacking.length} rooms`}</button>`}</span></div>
  </li>`;
}

function Cell({ cell, system, effect, place, most, current, focus }) {
  const state = cell?.state ?? 'untried';
  const shade = state === 'named' ? ` shade-${Math.min(Math.ceil((Math.max(cell.saving ?? 0, 0) / most.get(cell.unit)) * SHADES), SHADES)}` : '';
  const text = cell ? textOf(cell) : '';
  const label = `${system}, ${effect.title}: ${STATES[state]?.[1] ?? 'not tried'}${text ? ` ${text}` : ''}. ${cell?.why ?? ''}`;
  return html`<td role="gridcell" class=${`mark ${state}${shade}`} title=${label}><a data-at=${place} tabindex=${current ? 0 : -1} onFocus=${focus}
    href=${systemAddress(system, 'missing')} aria-label=${label}><span aria-hidden="true">${STATES[state]?.[0] ?? ' '} ${text}</span></a></td>`;
}

/** A row for each room and effect. */
function numbers(rows) {
  return {
    columns: [['room'], ['effect'], ['state'], ['saves', 'number'], ['unit'], ['t', 'number'], ['why']],
    rows: rows.flatMap(row =>
      row.cells.map(cell => [
        row.system,
        cell.effect,
        STATES[cell.state][1],
        cell.saving === null ? NONE : fixed(cell.saving),
        cell.unit ?? (cell.saving === null ? '' : NOISE),
        number(cell.t, 2),
        cell.why,
      ]),
    ),
  };
}
