// Two fits over the days that neither was fitted to: measured, before and after, in one chart.
import { html, useMemo, useState } from '../html.js';
import { useResource, withQuery } from '../api.js';
import { fixed, number, seconds } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Failed, Loading } from '../parts/screens.js';
import { linesOf, sampled } from '../charts/lines.js';
import { Strips } from '../charts/strips.js';

const POINTS = 2000;

export function Overlay({ before, after, output, zone }) {
  const { validation, test } = after.parts;
  const path =
    validation &&
    withQuery('/compare', { fits: `${before.id},${after.id}`, from: validation.from, to: (test ?? validation).to, max_points: POINTS });
  const compared = useResource(path ?? null);
  if (!path) return null;
  if (compared.error) return html`<${Failed} error=${compared.error} retry=${compared.reload} />`;
  if (!compared.data) return html`<${Loading} what="both fits over unseen data" />`;
  const name = output ?? Object.keys(compared.data.outputs)[0];
  // The one before may be that of another step, which is still on its way.
  if (!compared.data.outputs[name]?.simulated[after.id]) return html`<${Loading} what="both fits over unseen data" />`;
  return html`<${Both} key=${after.id} data=${compared.data} before=${before} after=${after} name=${name} path=${path} zone=${zone} />`;
}

function Both({ data, before, after, name, path, zone }) {
  const [range, setRange] = useState(null);
  const { unit, measured, simulated } = data.outputs[name];
  const time = useMemo(() => data.time.map(seconds), [data]);
  const parts = useMemo(
    () =>
      ['validation', 'test']
        .filter(part => after.parts[part])
        .map(part => ({ part, from: seconds(after.parts[part].from), to: seconds(after.parts[part].to) })),
    [after],
  );
  const lines = [
    ['measured', 'measured', undefined, sampled(linesOf(measured))],
    ['before', 'previous', [2, 3], linesOf(simulated[before.id])],
    ['after', 'model', [8, 3], linesOf(simulated[after.id])],
  ];
  const strips = useMemo(
    () => [{ label: name, unit, height: 220, lines: lines.map(([label, colour, dash, line]) => ({ label, colour, dash, width: 1.6, ...line })) }],
    [data, name],
  );
  const error = fit =>
    data.errors.find(row => row.fit === fit && row.output === name && row.horizon === 'free_run' && row.over === 'unseen');
  const [was, is] = [error(before.id), error(after.id)];
  const pair = was && is ? `rmse ${fixed(was.rmse)} → ${fixed(is.rmse)} ${is.unit} over ${after.parts.test ? 'validation and test' : 'validation'}` : 'no sample is unseen by both';
  const says = `Free runs of ${before.model} and of ${after.model} over ${is?.n ?? 0} samples that neither was fitted to: ${pair}.`;
  const series = lines.flatMap(([label, , , line]) =>
    Object.entries(line).map(([kind, values]) => [`${label} ${kind === 'values' ? '' : `${kind} `}${unit}`, values]),
  );
  const table = () => ({
    columns: [['time'], ...series.map(([title]) => [title, 'number'])],
    rows: data.time.map((at, row) => [at, ...series.map(([, values]) => number(values[row], 5))]),
  });
  return html`<${Frame} title=${`Before and after, ${name}: ${pair}`} path=${path} summary=${says} table=${table}
    note=${`${says}${data.thinning ? ' Thinned to the lowest and highest values.' : ''}`}>
    <${Strips} time=${time} strips=${strips} whole=${[time[0], time.at(-1)]} range=${range} parts=${parts} zone=${zone} label=${says}
      onZoom=${setRange} /></${Frame}>`;
}
