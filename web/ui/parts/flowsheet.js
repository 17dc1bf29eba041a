// A plant as its document lays it out: tanks, recycles, settler, and at each place where something is measured how far the model is off.
import { html, useRef } from '../html.js';
import { ask, useResource } from '../api.js';
import { setQuery } from '../router.js';
import { number, fixed } from '../format.js';
import { useWidth } from '../charts/axes.js';
import { baseOf } from './equations.js';
import { Frame } from './frame.js';
import { outputIn } from './outputs.js';

const TANK = { width: 146, height: 96, apart: 46 };
const SETTLER_PX = 146;
const INFLUENT_PX = 84;
const EFFLUENT_PX = 210;
const TOP = 52;
const TAG_PX = 26;
const TAG_WIDTH_PX = 132;
/** Times its noise up to which an error is that of a good model, and beyond which it is far off. */
const STRUCTURE = 1.6;
const FAR = 5;

const LEVELS = [
  ['ok', '●', `at most ${STRUCTURE} times the noise`],
  ['warn', '▲', `up to ${FAR} times`],
  ['bad', '■', `more than ${FAR} times`],
];
const levelOf = rho => (rho === null ? ['quiet', '○'] : LEVELS[rho <= STRUCTURE ? 0 : rho <= FAR ? 1 : 2]);

const layoutOf = (path, options) => ask(path, options).then(model => baseOf(model, options)).then(layout);

/** A number with its unit as a document has it: `55440[m3/d]` as `55440 m3/d`. */
const quantity = text => (/^[\d.]+\[[^\]]+\]$/.test(text ?? '') ? text.replace('[', ' ').replace(']', '') : '');

/** Tanks in the order of the flow and the places of the outputs; null of a model that is no plant. */
function layout(spec) {
  const { define = {}, outputs = {}, inputs = {} } = spec;
  const tanks = Object.keys(define).flatMap(name => /^V\[(.+)\]$/.exec(name)?.[1] ?? []);
  if (tanks.length === 0 || !define.Q_r) return null;
  const text = name => (typeof define[name] === 'string' ? define[name] : '');
  /** Where a name of the equations belongs: what is measured there is what the expression names first. */
  const placeOf = (expression, depth = 0) => {
    for (const [name, , within] of expression.matchAll(/([A-Za-z_]\w*)(?:\[(\w+)\])?/g)) {
      if (tanks.includes(within)) return within;
      if (/^s?\d+$/.test(within ?? '')) return 'settler';
      if (/_e$/.test(name) && text(name)) return 'effluent';
      if (/_r$/.test(name) && text(name)) return 'return sludge';
      if (inputs[name]) return 'influent';
      const place = depth < 4 && text(name) ? placeOf(text(name), depth + 1) : null;
      if (place) return place;
    }
    return null;
  };
  return {
    tanks: tanks.map(name => ({
      name,
      volume: quantity(text(`V[${name}]`)),
      aerated: Boolean(text(`kLa[${name}]`)),
      controlled: text('S_O_sensor') === `S_O[${name}]`,
    })),
    flows: Object.fromEntries(['Q_a', 'Q_r', 'Q_w'].map(name => [name, quantity(text(name))])),
    places: Object.fromEntries(Object.entries(outputs).map(([name, { expr }]) => [name, placeOf(expr)])),
  };
}

/** The plant of a model with the error of each output where it is measured; nothing for a model that is no plant. */
export function Flowsheet({ model, metrics, query }) {
  const path = `/models/${encodeURIComponent(model)}`;
  const plant = useResource(path, { read: layoutOf });
  if (!plant.data) return null;
  const shown = outputIn(query, metrics, true);
  const entries = Object.entries(metrics).map(([name, { rho, validation_rmse: unseen, train_rmse: train, unit }]) => ({
    name,
    rho,
    rmse: unseen ?? train,
    unit,
    place: plant.data.places[name] ?? null,
  }));
  const each = entries.map(({ name, rho }) => `${name} ${number(rho)}`).join(', ');
  const says = `Free-run error of each output in multiples of the noise left in it: ${each}.`;
  const lost = entries.filter(({ place }) => place === null).map(({ name }) => name);
  const unsaid = lost.length ? ` The document does not say where ${lost.join(' and ')} is measured.` : '';
  return html`<${Frame} title="The plant, and where the model fails in it" about=${says} path=${path} summary=${says}
    note=${`${says} Choose an output to see its chart.${unsaid}`}
    table=${() => ({
      columns: [['output'], ['measured at'], ['error, times its noise', 'number'], ['rmse of the free run', 'number'], ['unit']],
      rows: entries.map(({ name, place, rho, rmse, unit }) => [name, place ?? 'not said', number(rho), fixed(rmse), unit]),
    })}>
    <${Drawing} plant=${plant.data} entries=${entries} shown=${shown} />
    <p class="legend"><span>Error:</span>${LEVELS.map(([tone, shape, words]) =>
      html`<span class=${`status ${tone}`}><span class="shape">${shape}</span> ${words}</span>`)}</p>
  </${Frame}>`;
}

function Drawing({ plant, entries, shown }) {
  const host = useRef(null);
  const { tanks, flows } = plant;
  const at = place => entries.filter(entry => entry.place === place);
  const given = useWidth(host);
  const least = INFLUENT_PX + tanks.length * (TANK.width + TANK.apart) + SETTLER_PX + EFFLUENT_PX;
  // What a wide screen has left goes between the tanks; on a narrow one what stands behind the settler comes to the front.
  const room = Math.min(Math.max((given - least) / (tanks.length + 1), 0), 60);
  const narrow = given < least;
  const left = index => INFLUENT_PX + index * (TANK.width + TANK.apart + room);
  const settler = left(tanks.length);
  const out = settler + SETTLER_PX;
  const most = Math.max(...tanks.map(({ name }) => at(name).length));
  const deep = Math.max(TANK.height, 66 + most * TAG_PX, at('settler').length * TAG_PX + 66);
  const [middle, bottom] = [TOP + 26, TOP + deep];
  const sludge = bottom + 34;
  const below = narrow ? Math.ceil(at('effluent').length / 2) * TAG_PX + 28 : 0;
  const height = Math.max(sludge + 12 + Math.max(at('return sludge').length, 1) * TAG_PX, narrow ? 0 : TOP + at('effluent').length * TAG_PX + 8) + below;
  const first = left(0) + TANK.width / 2;
  const last = left(tanks.length - 1) + TANK.width / 2;
  const tags = (place, x, y, columns = 1) =>
    at(place).map((entry, index) => html`<${Tag} key=${entry.name} entry=${entry} pressed=${entry.name === shown}
      x=${x + (index % columns) * (TAG_WIDTH_PX + 6)} y=${y + Math.floor(index / columns) * TAG_PX} />`);
  const width = narrow ? out + 48 : out + EFFLUENT_PX + room;
  return html`<div ref=${host}><div class="scroll" tabindex="0" role="region" aria-label="The plant">
    <svg class="chart flowsheet" style="width:auto" role="group" aria-label="Flow sheet of the plant" width=${width} height=${height}
      viewBox=${`0 0 ${width} ${height}`}>
      <text x="4" y=${middle - 8}>influent</text>
      <${Flow} points=${[[4, middle], [left(0), middle]]} />
      ${tags('influent', 4, middle + 12)}
      ${tanks.map((tank, index) => html`<g key=${tank.name}>
        <rect class="tank" x=${left(index)} y=${TOP} width=${TANK.width} height=${deep} rx="4" />
        <text x=${left(index) + 8} y=${TOP + 18} style="font-weight:600">${tank.name}</text>
        <text class="quiet" x=${left(index) + 8} y=${TOP + 34}>${tank.volume}</text>
        ${(tank.aerated || tank.controlled) &&
          html`<text class="quiet" x=${left(index) + 8} y=${bottom - 8}>∘∘∘ ${tank.controlled ? 'oxygen controlled' : 'aerated'}</text>`}
        ${tags(tank.name, left(index) + 6, TOP + 42)}
        <${Flow} points=${[[left(index) + TANK.width, middle], [left(index + 1), middle]]} />
      </g>`)}
      <path class="tank" d=${`M${settler},${TOP}H${out}V${bottom - 26}L${settler + SETTLER_PX / 2},${bottom}L${settler},${bottom - 26}Z`} />
      <text x=${settler + SETTLER_PX / 2} y=${TOP + 18} text-anchor="middle" style="font-weight:600">settler</text>
      ${tags('settler', settler + 7, TOP + 34)}
      <${Flow} points=${[[out, middle], [out + 40, middle]]} /><text x=${out + 8} y=${middle - 8}>effluent</text>
      ${!narrow && tags('effluent', out + 64, TOP + 4)}
      ${narrow && at('effluent').length > 0 && html`<text x="4" y=${height - below + 12}>measured in the effluent</text>
        ${tags('effluent', 4, height - below + 22, 2)}`}
      <${Flow} points=${[[last, TOP], [last, TOP - 26], [first, TOP - 26], [first, TOP]]} />
      <text class="quiet" x=${first + 8} y=${TOP - 32}>internal recycle ${flows.Q_a}</text>
      <${Flow} points=${[[settler + SETTLER_PX / 2, bottom], [settler + SETTLER_PX / 2, sludge], [first, sludge], [first, bottom]]} />
      <text class="quiet" x=${first + 8} y=${sludge - 6}>return sludge ${flows.Q_r}</text>
      ${tags('return sludge', last + 80, sludge + 4)}
      <${Flow} points=${[[settler + SETTLER_PX / 2, sludge], [out + 40, sludge]]} />
      <text class="quiet" x=${settler + SETTLER_PX / 2 + 8} y=${sludge - 6}>wasted ${flows.Q_w}</text>
    </svg></div></div>`;
}

/** A line with an arrow at its end. */
function Flow({ points }) {
  const [[x0, y0], [x, y]] = points.slice(-2);
  const [dx, dy] = [Math.sign(x - x0), Math.sign(y - y0)];
  return html`<g class="flow"><path fill="none" d=${`M${points.map(point => point.join(',')).join('L')}`} />
    <path class="arrow" d=${`M${x},${y}L${x - 8 * dx - 4 * dy},${y - 8 * dy - 4 * dx}L${x - 8 * dx + 4 * dy},${y - 8 * dy + 4 * dx}Z`} /></g>`;
}

/** An output at its place: what is wrong with it as a shape, a number and a colour. It is chosen like a button. */
function Tag({ entry, pressed, x, y }) {
  const { name, rho } = entry;
  const [tone, shape] = levelOf(rho);
  const text = rho === null ? name : `${name} ${number(rho)} ×`;
  const choose = () => setQuery({ output: name });
  const onKeyDown = event => {
    if (event.key !== 'Enter' && event.key !== ' ') return;
    event.preventDefault();
    choose();
  };
  return html`<g class="tag" role="button" tabindex="0" aria-pressed=${pressed} aria-label=${`${shape} ${text}${rho === null ? '' : ' its noise'}`}
    onClick=${choose} onKeyDown=${onKeyDown}>
    <rect x=${x} y=${y} width=${TAG_WIDTH_PX} height=${TAG_PX - 2} rx="5" />
    <text class=${`status ${tone}`} x=${x + 8} y=${y + 16}><tspan class="shape">${shape}</tspan></text>
    <text x=${x + 24} y=${y + 16}>${text}</text></g>`;
}
