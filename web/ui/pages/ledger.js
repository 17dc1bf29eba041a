// What all windows of a system show of every effect, each for itself and together.
import { html } from '../html.js';
import { useResource } from '../api.js';
import { address } from '../router.js';
import { number, percent, day, seconds, words, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Term } from '../parts/term.js';
import { Shown, Empty } from '../parts/screens.js';
import { Windows } from '../charts/windows.js';

/** Below this pooled t an effect does not stand out, and is shown to those who ask. */
const CLEAR_T = 2;
/** As many of a hundred stand out by chance alone. */
const BY_CHANCE = 0.05;
const COLUMNS = [
  ['effect'], ['from'], ['to'], ['size', 'number'], ['deviation', 'number'], ['unit'], ['t', 'number'], ['beyond the clock', 'number'],
  ['of the error', 'number'], ['days', 'number'], ['p of shifts', 'number'], ['added up'],
];

export function Ledger({ system, model }) {
  const path = `/systems/${system}/evidence?model=${encodeURIComponent(model)}`;
  const evidence = useResource(path);
  return html`<section class="ledger" aria-labelledby="ledger"><h2 id="ledger">What all windows show <${Term} of="pooled">together</${Term}></h2>
    <${Shown} of=${evidence} what="what the windows show" show=${({ effects }) =>
      effects.length === 0
        ? html`<${Empty} title="No window has been added up yet"><p>Every diagnosis of ${model} adds what its window shows of every effect.
            One window shows little; several that agree show what is there.</p></${Empty}>`
        : html`<${Effects} effects=${effects} path=${path} model=${model} />`} /></section>`;
}

function Effects({ effects, path, model }) {
  const windows = effects.flatMap(effect => effect.windows);
  const span = [Math.min(...windows.map(({ from }) => seconds(from))), Math.max(...windows.map(({ to }) => seconds(to)))];
  const clear = effects.filter(({ pooled }) => Math.abs(pooled?.t ?? 0) >= CLEAR_T);
  const others = effects.filter(effect => !clear.includes(effect));
  const rows = list => list.map(effect => html`<${Row} key=${effect.effect} effect=${effect} span=${span} />`);
  const says = clear.length
    ? `Beside ${model}, ${clear.length} of ${effects.length} effects stand out by two deviations or more, as ${Math.max(1, Math.round(BY_CHANCE * effects.length))} would by chance: ${clear.map(({ effect }) => effect).join(', ')}. The verdict of a diagnosis counts how many were tried.`
    : `Beside ${model}, none of ${effects.length} effects stands out by two deviations.`;
  return html`<${Frame} title="Effects by window" path=${path} summary=${says}
    note="A dot is what one window shows, with its 95 % interval; hollow dots are not added up, mostly because a newer window holds their samples. The dashed line with its band is what the windows show together, if it is one size."
    table=${() => ({ columns: COLUMNS, rows: effects.flatMap(numbers) })}>
    ${clear.length ? rows(clear) : html`<p>${says}</p>`}
    ${others.length > 0 && html`<details><summary>Show all: ${others.length} more that do not stand out</summary>${rows(others)}</details>`}
  </${Frame}>`;
}

function Row({ effect, span }) {
  const { effect: id, windows, pooled } = effect;
  const says = pooled?.sentence ?? 'No window has a size with a deviation.';
  return html`<div class="windows">
    <div><h4><a href=${address(['effects', id.split(':')[0]])}>${id}</a></h4>
      <p>${says}</p>${pooled?.taken_back && html`<p>▲ ${pooled.taken_back.sentence}</p>`}</div>
    <${Windows} windows=${windows} pooled=${pooled} span=${span} unit=${windows[0].unit} label=${`${id}. ${says}`} />
  </div>`;
}

/** The windows of an effect as rows, and what they show together as the last one. */
function numbers({ effect, windows, pooled }) {
  const row = (one, last) => [
    effect,
    day(one.from),
    day(one.to),
    number(one.size),
    number(one.deviation),
    one.unit,
    number(one.t),
    number(one.beyond_clock),
    percent(one.share),
    one.days ?? NONE,
    number(one.shift_p),
    last,
  ];
  return [
    ...windows.map(window => row(window, window.pooled ? 'yes' : `no: ${words(window.apart)}`)),
    ...(pooled ? [row(pooled, `${pooled.windows} together${pooled.i2 === null ? '' : `, I2 ${percent(pooled.i2)}`}`)] : []),
  ];
}
