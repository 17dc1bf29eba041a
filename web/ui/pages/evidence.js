// The unexplained error beside an effect's own shape: whether they match is for the eyes.
import { html, useMemo, useState } from '../html.js';
import { number, signed, length, clock, seconds, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Strips } from '../charts/strips.js';
import { Scatter } from '../charts/scatter.js';

const rms = values => Math.sqrt(values.reduce((sum, value) => sum + value * value, 0) / values.length);

/** The stretches of the data as charts shade them. */
function partsOf(shape, time) {
  const starts = [
    ['train', time[0]],
    ['validation', seconds(shape.validation_from)],
    ...(shape.test_from ? [['test', seconds(shape.test_from)]] : []),
  ];
  return starts.map(([part, from], at) => ({ part, from, to: starts[at + 1]?.[1] ?? time.at(-1) }));
}

/** `output` is the one whose error the service has laid beside the effect. */
export function Evidence({ finding, output, path, zone }) {
  const { shape } = finding;
  if (!shape) return null;
  const about = `${output}, ${clock(shape.time[0], zone)} to ${clock(shape.time.at(-1), zone)} (${zone})`;
  return html`<div class="grid">
    <${Lines} shape=${shape} title=${finding.title} output=${output} about=${about} path=${path} zone=${zone} />
    ${shape.added && html`<${Added} shape=${shape} title=${finding.title} output=${output} about=${about} path=${path} />`}
  </div>`;
}

function Lines({ shape, title, output, about, path, zone }) {
  const [range, setRange] = useState(null);
  const time = useMemo(() => shape.time.map(seconds), [shape]);
  const parts = useMemo(() => partsOf(shape, time), [shape, time]);
  const strips = useMemo(
    () => [
      {
        label: `Error of ${output}`,
        unit: shape.unit,
        height: 216,
        zero: true,
        lines: [
          { label: 'unexplained', colour: 'measured', values: shape.unexplained },
          { label: 'the effect', colour: 'model', dash: [6, 3], width: 2, values: shape.effect },
        ],
      },
    ],
    [shape, output],
  );
  const unseen = time.flatMap((at, index) =>
    at >= seconds(shape.validation_from) && shape.unexplained[index] !== null ? [[shape.unexplained[index], shape.effect[index]]] : [],
  );
  const says =
    unseen.length > 0 &&
    `On data that neither model was fitted to, ${number(rms(unseen.map(([error]) => error)), 2)} ${shape.unit} are unexplained without it, and ${number(rms(unseen.map(([error, effect]) => error - effect)), 2)} ${shape.unit} lie between the two lines.`;
  return html`<${Frame} title=${`${title}: the unexplained error beside its shape`} about=${`${about}. ${says || ''}`} path=${path} summary=${says || ''}
    note=${`Unexplained: measured − the model without it. The effect: by how much the free run rises with it. Where the lines go together, it is what was missing. ${says || ''} Points are means of ${length(shape.mean_over_s)}.`}
    table=${() => ({
      columns: [['time'], [`unexplained, ${shape.unit}`, 'number'], [`the effect, ${shape.unit}`, 'number']],
      rows: shape.time.map((at, index) => [at, ...[shape.unexplained, shape.effect].map(line => line[index] ?? NONE)]),
    })}>
    <${Strips} time=${time} strips=${strips} whole=${[time[0], time.at(-1)]} range=${range} parts=${parts} zone=${zone} onZoom=${setRange}
      label=${says || title} />
  </${Frame}>`;
}

/** The errors by what the effect would add to them: a slope of 1 is the effect, a level line is nothing. */
function Added({ shape, title, output, about, path }) {
  const { added, unit } = shape;
  const [least, most] = [added.bins[0], added.bins.at(-1)];
  const says = `Where the effect would add ${signed(least.effect, 3)} ${unit}, ${signed(least.unexplained, 3)} ${unit} are unexplained; where it would add ${signed(most.effect, 3)}, ${signed(most.unexplained, 3)}.`;
  return html`<${Frame} title=${`${title}: unexplained by what it would add`} about=${about} path=${path} summary=${says}
    note=${`Errors of ${output} over stretches of twelve hours, of a plant those of the free run; what the model's own parameters and the start of a stretch can imitate is taken from both axes. ${says} On the dashed line lies an effect as large as was found; a level line would mean that it adds nothing. A point is the mean of about ${least.samples} samples with its 95 % interval from resampled days.`}
    table=${() => ({
      columns: [
        [`the effect would add, ${unit}`, 'number'],
        [`unexplained, ${unit}`, 'number'],
        ['95 % from', 'number'],
        ['to', 'number'],
        ['samples', 'number'],
      ],
      rows: added.bins.map(bin => [
        ...[bin.effect, bin.unexplained, ...(bin.unexplained_ci95 ?? [null, null])].map(value => number(value)),
        bin.samples,
      ]),
    })}>
    <${Scatter} line=${added} xLabel=${`the effect would add, ${unit}`} yLabel=${`unexplained, ${unit}`} label=${says}
      points=${added.bins.map(bin => ({
        x: bin.effect,
        y: bin.unexplained,
        low: bin.unexplained_ci95?.[0] ?? null,
        high: bin.unexplained_ci95?.[1] ?? null,
        title: `the effect ${signed(bin.effect, 3)} ${unit}, unexplained ${signed(bin.unexplained, 3)} ${unit}, ${bin.samples} samples`,
      }))} />
  </${Frame}>`;
}
