// Lines over time: strips below each other with one time axis, one crosshair and one zoom.
import { html, useRef, useLayoutEffect, useState, useMemo, useId } from '../html.js';
import { colour, useScheme } from '../theme.js';
import { number, clock, decimalsOfAll, reading } from '../format.js';
import { useWidth } from './axes.js';

const { uPlot } = window;
const AXIS_PX = 58;
const TIME_AXIS_PX = 40;
const ZOOM_STEP = 0.25;
/** From so many points in a pixel on, a line has no dashes. */
const CROWDED = 8;
// The rows of uPlot's table of time labels, with clocks of 24 hours: step in seconds, label, and what a new year, month or day adds.
const TIMES = [
  [31_536_000, '{YYYY}', null, null, null, null, null, null, 1],
  [2_419_200, '{MMM}', '\n{YYYY}', null, null, null, null, null, 1],
  [86_400, '{D} {MMM}', '\n{YYYY}', null, null, null, null, null, 1],
  [60, '{HH}:{mm}', '\n{D} {MMM} {YYYY}', null, '\n{D} {MMM}', null, null, null, 1],
  [1, '{HH}:{mm}:{ss}', '\n{D} {MMM} {YYYY}', null, '\n{D} {MMM}', null, null, null, 1],
];

/** The stretches where a line has no values, as pairs of times. */
function gapsOf(time, line) {
  const values = line.values ?? line.min;
  const gaps = [];
  for (let at = 0; at < values.length; at += 1) {
    if (values[at] !== null) continue;
    const start = at;
    while (at + 1 < values.length && values[at + 1] === null) at += 1;
    gaps.push([time[Math.max(start - 1, 0)], time[Math.min(at + 1, time.length - 1)]]);
  }
  return gaps;
}

/** What lies behind the lines: the parts of the data, gaps, the line of zero. */
function background(plot, strip, parts, gaps, first) {
  const { ctx, bbox } = plot;
  const across = time => Math.min(Math.max(plot.valToPos(time, 'x', true), bbox.left), bbox.left + bbox.width);
  ctx.save();
  for (const { part, from, to } of parts) {
    const [left, right] = [across(from), across(to)];
    if (right <= left) continue;
    ctx.fillStyle = colour(part);
    ctx.fillRect(left, bbox.top, right - left, bbox.height);
    ctx.strokeStyle = colour('strong-edge');
    ctx.setLineDash([3, 3]);
    ctx.beginPath();
    ctx.moveTo(left, bbox.top);
    ctx.lineTo(left, bbox.top + bbox.height);
    ctx.stroke();
    if (first && right - left > 60) {
      ctx.fillStyle = colour('quiet');
      ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
      ctx.fillText(part === 'train' ? 'train (fitted)' : part, left + 5 * devicePixelRatio, bbox.top + 12 * devicePixelRatio);
    }
  }
  ctx.setLineDash([]);
  ctx.strokeStyle = colour('grid');
  for (const [from, to] of gaps) {
    const [left, right] = [across(from), across(to)];
    ctx.beginPath();
    for (let x = left; x < right; x += 6 * devicePixelRatio) {
      ctx.moveTo(x, bbox.top + bbox.height);
      ctx.lineTo(Math.min(x + 8 * devicePixelRatio, right), bbox.top);
    }
    ctx.stroke();
  }
  if (strip.zero) {
    const zero = plot.valToPos(0, 'y', true);
    ctx.strokeStyle = colour('strong-edge');
    ctx.beginPath();
    ctx.moveTo(bbox.left, zero);
    ctx.lineTo(bbox.left + bbox.width, zero);
    ctx.stroke();
  }
  ctx.restore();
}

/** A line is one series, or two with the area between them where it is thinned to its extremes. */
function seriesOf(strip, dense) {
  const series = [{}];
  const bands = [];
  const data = [];
  for (const line of strip.lines) {
    const stroke = colour(line.colour);
    // Hair lines are drawn ten times as fast; where samples are closer than pixels nothing is lost.
    const look = { stroke, width: dense ? 1 : (line.width ?? 1.5), dash: line.dash, dashes: line.dash, points: { show: false } };
    if (line.step) look.paths = uPlot.paths.stepped({ align: 1 });
    if (line.values) {
      series.push(look);
      data.push(line.values);
    } else {
      bands.push({ series: [series.length + 1, series.length], fill: `${stroke}44` });
      series.push({ ...look, width: 0.8 }, { ...look, width: 0.8 });
      data.push(line.min, line.max);
    }
  }
  return { series, bands, data };
}

function draw(target, strip, { time, width, zone, parts, gaps, sync, first, last, onSelect, onCursor }) {
  const { series, bands, data } = seriesOf(strip, time.length > 2 * width);
  const axis = {
    stroke: colour('quiet'),
    grid: { stroke: colour('grid'), width: 1 },
    ticks: { stroke: colour('grid'), width: 1 },
    font: '11px system-ui, sans-serif',
  };
  return new uPlot(
    {
      width,
      height: strip.height + (last ? TIME_AXIS_PX : 0),
      tzDate: at => uPlot.tzDate(new Date(at * 1e3), zone),
      series,
      bands,
      legend: { show: false },
      padding: [6, 26, last ? 0 : 6, 0],
      scales: {
        x: { time: true, auto: false },
        y: strip.zero
          ? {
              range: (_, low, high) => {
                const most = Math.max(Math.abs(low ?? 0), Math.abs(high ?? 0), 1e-6) * 1.05;
                return [-most, most];
              },
            }
          : {
              // A level line lies in the middle of its strip.
              range: (_, low, high) => (low === null ? [null, null] : low === high ? [low - 1, high + 1] : uPlot.rangeNum(low, high, 0.1, true)),
            },
      },
      axes: [
        last ? { ...axis, values: TIMES, size: TIME_AXIS_PX } : { ...axis, values: () => [], ticks: { show: false }, size: 0 },
        { ...axis, size: AXIS_PX, space: strip.height > 100 ? 32 : 22, values: (_, marks) => marksOf(marks) },
      ],
      cursor: {
        sync: { key: sync, setSeries: false, scales: ['x', null] },
        drag: { x: true, y: false, setScale: false },
        y: false,
        points: { show: false },
      },
      hooks: {
        drawClear: [plot => background(plot, strip, parts, gaps, first)],
        setSelect: [
          plot => {
            if (plot.select.width < 4) return;
            const from = plot.posToVal(plot.select.left, 'x');
            const to = plot.posToVal(plot.select.left + plot.select.width, 'x');
            plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
            onSelect([from, to]);
          },
        ],
        setCursor: [plot => onCursor(plot.cursor.idx)],
      },
    },
    [time, ...data],
    target,
  );
}

/** Marks of an axis, of which no two read the same. */
function marksOf(marks) {
  const step = Math.abs(marks[1] - marks[0]);
  const most = Math.max(...marks.map(Math.abs));
  return marks.map(mark => number(mark, Math.max(3, step > 0 ? Math.floor(Math.log10(most / step)) + 2 : 3)));
}

/** The value of a line at the pointer. */
function read(line, at, decimals) {
  if (at === null || at === undefined) return '';
  // Between two samples of a slower sensor its last one is told.
  if (line.values) {
    let last = at;
    while (last > 0 && line.values[last] === undefined) last -= 1;
    return reading(line.values[last], decimals);
  }
  return line.min[at] === null ? reading(null) : `${reading(line.min[at], decimals)} to ${reading(line.max[at], decimals)}`;
}

/**
 * Strips: `{label, unit, height, lines, zero}`; lines: `{label, colour, dash, width, step, values | min, max}`, all
 * at `time` (seconds). `range` is what is shown, null for the `whole`; `onZoom` hears of every change that is asked.
 */
export function Strips({ time, strips, range, whole, parts = [], zone = 'UTC', onZoom, label }) {
  const root = useRef(null);
  const plots = useRef([]);
  const readers = useRef([]);
  const when = useRef(null);
  const width = useWidth(root);
  const scheme = useScheme();
  const sync = useId();
  const [low, high] = range ?? whole;
  const [panning, setPanning] = useState(false);
  // The lines of a strip are read with the same decimals, so that they can be compared.
  const decimals = useMemo(
    () => strips.map(strip => decimalsOfAll(strip.lines.flatMap(line => line.values ?? [...line.min, ...line.max]), strip.unit)),
    [strips],
  );
  const gaps = useMemo(() => (strips[0]?.lines[0] ? gapsOf(time, strips[0].lines[0]) : []), [time, strips]);
  const shown = useRef([low, high]);
  const asked = useRef(onZoom);
  asked.current = onZoom;

  const show = ([from, to]) => {
    shown.current = [from, to];
    const points = time.length * Math.min((to - from) / Math.max(whole[1] - whole[0], 1), 1);
    for (const plot of plots.current) {
      // Dashes take much of the time of drawing, and nobody sees them where many points share a pixel.
      for (const line of plot.series) if (line.dashes) line.dash = points > CROWDED * plot.width ? [] : line.dashes;
      plot.setScale('x', { min: from, max: to });
    }
  };
  useLayoutEffect(() => {
    if (!width) return undefined;
    const hosts = [...root.current.querySelectorAll('.plot')];
    plots.current = strips.map((strip, index) =>
      draw(hosts[index], strip, {
        time,
        width,
        zone,
        parts,
        gaps,
        sync,
        first: index === 0,
        last: index === strips.length - 1,
        onSelect: chosen => asked.current(chosen),
        onCursor: at => {
          if (index === 0) when.current.textContent = at === null || at === undefined ? '' : clock(time[at] * 1000, zone);
          readers.current[index]?.querySelectorAll('output').forEach((place, line) => {
            place.textContent = read(strip.lines[line], at, decimals[index]);
          });
        },
      }),
    );
    show(shown.current);
    return () => plots.current.forEach(plot => plot.destroy());
  }, [time, strips, parts, zone, width, scheme]);
  useLayoutEffect(() => show([low, high]), [low, high]);

  const moved = (share, factor) => {
    const [from, to] = shown.current;
    const span = (to - from) * factor;
    const middle = (from + to) / 2 + (to - from) * share;
    return clamped([middle - span / 2, middle + span / 2], whole);
  };
  const keys = {
    ArrowLeft: () => moved(-ZOOM_STEP, 1),
    ArrowRight: () => moved(ZOOM_STEP, 1),
    '+': () => moved(0, 1 - 2 * ZOOM_STEP),
    '=': () => moved(0, 1 - 2 * ZOOM_STEP),
    '-': () => moved(0, 1 / (1 - 2 * ZOOM_STEP)),
    z: () => null,
    0: () => null,
  };
  const onKeyDown = event => {
    if (event.target !== root.current || !keys[event.key] || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    onZoom(keys[event.key]());
  };
  // Shift and drag moves the range, a pinch or Ctrl and wheel zooms: drawn at once, told when it ends.
  const onMouseDown = event => {
    if (!event.shiftKey) return;
    event.stopPropagation();
    event.preventDefault();
    const [from, to] = shown.current;
    const perPixel = (to - from) / Math.max(width - AXIS_PX, 1);
    setPanning(true);
    const move = now =>
      show(clamped([from - (now.clientX - event.clientX) * perPixel, to - (now.clientX - event.clientX) * perPixel], whole));
    const end = () => {
      removeEventListener('mousemove', move);
      setPanning(false);
      asked.current(shown.current);
    };
    addEventListener('mousemove', move);
    addEventListener('mouseup', end, { once: true });
  };
  const told = useRef(null);
  useLayoutEffect(() => {
    const wheel = event => {
      if (!event.ctrlKey) return;
      event.preventDefault();
      show(moved(0, event.deltaY > 0 ? 1.15 : 1 / 1.15));
      clearTimeout(told.current);
      told.current = setTimeout(() => asked.current(shown.current), 200);
    };
    const host = root.current;
    host.addEventListener('wheel', wheel, { passive: false });
    host.addEventListener('mousedown', onMouseDown, true);
    return () => {
      host.removeEventListener('wheel', wheel);
      host.removeEventListener('mousedown', onMouseDown, true);
    };
  });

  const zoomed = range !== null;
  return html`
    <div class="row apart">
      <span class="row" role="group" aria-label="Zoom">
        <button class="plain" onClick=${() => onZoom(keys['+']())} aria-label="Zoom in">+</button>
        <button class="plain" onClick=${() => onZoom(keys['-']())} aria-label="Zoom out" disabled=${!zoomed}>−</button>
        <button class="plain" onClick=${() => onZoom(keys.ArrowLeft())} aria-label="Earlier" disabled=${!zoomed}>←</button>
        <button class="plain" onClick=${() => onZoom(keys.ArrowRight())} aria-label="Later" disabled=${!zoomed}>→</button>
        <button class="plain" onClick=${() => onZoom(null)} disabled=${!zoomed}>Whole range</button>
        <output class="number" aria-hidden="true" ref=${when}></output>
      </span>
      <span class="note">Drag to zoom, Shift and drag to move. <span class="told">Times are ${zone}.</span></span>
    </div>
    <div class="strips ${panning ? 'panning' : ''}" ref=${root} tabindex="0" role="group"
      aria-label=${`${label}. Arrow keys move, plus and minus zoom, z shows the whole range.`}
      onKeyDown=${onKeyDown} onDblClick=${() => onZoom(null)}>
      ${strips.map(
        (strip, index) => html`<div class="strip" key=${strip.label}>
        <div class="legend" ref=${place => {
          readers.current[index] = place;
        }}>
          <span><b>${strip.label}</b> <span class="quiet">${strip.unit}</span></span>
          ${strip.lines.map(
            line => html`<span>
            ${strip.lines.length > 1 && html`<${Sample} line=${line} />${line.label} `}<output aria-hidden="true"></output></span>`,
          )}
        </div>
        <div class="plot"></div>
      </div>`,
      )}
    </div>`;
}

const Sample = ({ line }) => html`<svg width="24" height="10" aria-hidden="true"><line x1="0" x2="24" y1="5" y2="5"
  style=${{ stroke: `var(--${line.colour})`, strokeWidth: Math.max(line.width ?? 1.5, 1.5),
    strokeDasharray: line.dash?.join(' ') ?? 'none' }} /></svg> `;

/** A range that lies inside of the whole, with the length that was asked where there is room. */
function clamped([from, to], [first, last]) {
  const span = Math.min(to - from, last - first);
  const start = Math.min(Math.max(from, first), last - span);
  return [start, start + span];
}
