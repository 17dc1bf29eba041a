// Which estimates err together: all pairs as colours, the strongest in words.
import { html } from '../html.js';
import { named, number, plainly, reading, signed, unitOf } from '../format.js';
import { Frame } from '../parts/frame.js';
import { useTitles } from '../parts/names.js';
import { Table } from '../parts/table.js';
import { Curve } from '../charts/curve.js';
import { Matrix } from '../charts/matrix.js';

/** So many pairs are said in words. */
const SAID = 3;

/** Whether a remark is the sentence about a pair that these data cannot tell apart. */
export const isOf = (pair, remark) => remark.startsWith(`${pair.parameters.join(' and ')} `);

/** The correlations of the estimates by row and column, from their covariance; what does not vary goes with nothing. */
function correlationsOf({ matrix }) {
  const deviations = matrix.map((row, at) => Math.sqrt(Math.max(row[at], 0)));
  return matrix.map((row, from) =>
    row.map((value, to) => {
      const size = deviations[from] * deviations[to];
      return from === to ? 1 : size > 0 ? Math.min(Math.max(value / size, -1), 1) : 0;
    }),
  );
}

export function Correlations({ fit }) {
  const pairs = fit.correlated.toSorted((a, b) => Math.abs(b.correlation) - Math.abs(a.correlation));
  const names = fit.covariance?.parameters ?? [];
  const titles = useTitles(fit.model);
  const remarkOf = pair =>
    fit.remarks.find(remark => isOf(pair, remark)) ?? `${pair.parameters.join(' and ')} move together (correlation ${number(pair.correlation)})`;
  const said = pair => html`<li>▲ ${plainly(remarkOf(pair), { titles })}.
    ${pair.ridge.length > 1 && html`<${AlongRidge} pair=${pair} fit=${fit} />`}</li>`;
  const rest = pairs.slice(SAID);
  return html`
    ${pairs.length > 0 && html`<ul>${pairs.slice(0, SAID).map(said)}</ul>`}
    ${rest.length > 0 && html`<details><summary>${rest.length} more ${rest.length === 1 ? 'pair' : 'pairs'}</summary><ul>${rest.map(said)}</ul></details>`}
    ${names.length > 1 && html`<${Pairs} fit=${fit} names=${names} />`}`;
}

function Pairs({ fit, names }) {
  const values = correlationsOf(fit.covariance);
  const alone = Object.fromEntries(fit.correlated.flatMap(({ parameters: [name, other], correlation }) =>
    [[`${name} ${other}`, correlation], [`${other} ${name}`, correlation]]));
  const ofData = (from, to) => alone[`${names[from]} ${names[to]}`];
  const rows = values
    .flatMap((row, from) => row.flatMap((value, to) => (to > from ? [{ from, to, value, alone: ofData(from, to) }] : [])))
    .toSorted((a, b) => Math.abs(b.alone ?? b.value) - Math.abs(a.alone ?? a.value));
  const flagged = fit.correlated.length;
  const says =
    flagged > 0
      ? `${flagged} of ${rows.length} pairs cannot be told apart by these data.`
      : `These data can tell all ${rows.length} pairs apart. The closest are ${names[rows[0].from]} and ${names[rows[0].to]}: ${signed(rows[0].value, 2)}.`;
  return html`<${Frame} title="Which estimates err together" path=${`/fits/${fit.id}`} summary=${says}
    note=${`${says} Near +1 or −1 only what two parameters do together is known, and neither of them alone. The bounds of the search count as knowledge here; ▲ marks pairs that go together even more (beyond ±0.95) by the data alone. Point at a cell for its numbers.`}
    table=${() => ({
      columns: [['parameter'], ['with'], ['correlation', 'number'], ['by the data alone, where beyond ±0.95', 'number']],
      rows: rows.map(row => [names[row.from], names[row.to], reading(row.value, 3), reading(row.alone, 3)]),
    })}>
    <${Matrix} names=${names} values=${values} marked=${ofData} label=${says} />
  </${Frame}>`;
}

/** Where the first of a pair is held and all else is fitted again: the least cost, and what the second becomes. */
function AlongRidge({ pair, fit }) {
  const [held, other] = pair.parameters;
  const titles = useTitles(fit.model);
  const axis = name => `${named(name, titles)} ${unitOf(fit.parameters[name].unit)}`;
  const across = [pair.ridge[0].values[0], pair.ridge.at(-1).values[0]];
  const drawn = (what, points) => html`<div><b>${what}</b>
    <${Curve} height=${150} xLabel=${axis(held)} yLabel="" across=${across} label=${`${what} where ${held} is held`}
      lines=${[{ label: '', colour: 'model', open: true, points }]} /></div>`;
  return html`<details><summary>Along the ridge: ${named(held, titles)} is held, all else is fitted again</summary>
    <div class="small-multiples">
      ${drawn('least cost', pair.ridge.map(point => [point.values[0], point.cost]))}
      ${drawn(axis(other), pair.ridge.map(point => point.values))}
    </div>
    <${Table} caption=${`${held} is held, all else is fitted again`} columns=${[[axis(held), 'number'], [axis(other), 'number'], ['least cost', 'number']]}
      rows=${pair.ridge.map(({ values, cost }) => [...values.map(value => number(value, 4)), number(cost, 4)])} /></details>`;
}
