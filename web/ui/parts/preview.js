// What a model does: a short simulation with the nominal values, on measurements or on two standard days.
import { html, useState, useEffect, useMemo } from '../html.js';
import { post, curl } from '../api.js';
import { useSystems } from '../systems.js';
import { seconds, number, NONE } from '../format.js';
import { Frame, Command } from './frame.js';
import { Failed, Loading } from './screens.js';
import { Strips } from '../charts/strips.js';

const SETTLE_MS = 400;

/** Faults of the document that is written stand at its lines, not here. */
const ofDocument = error => error.errors.length > 0 && error.errors.every(fault => /^\/(model|effects)\b/.test(fault.pointer));

function stripsOf(data) {
  const outputs = Object.entries(data.outputs).map(([name, output]) => ({
    label: name,
    unit: output.unit,
    height: 170,
    lines: [
      ...(output.measured.some(value => value !== null) ? [{ label: 'measured', colour: 'measured', values: output.measured }] : []),
      { label: 'model', colour: 'model', dash: [8, 3], values: output.simulated },
    ],
  }));
  const small = (entries, colour) =>
    Object.entries(entries).map(([name, curve]) => ({
      label: name,
      unit: curve.unit,
      height: 60,
      lines: [{ label: name, colour, values: curve.values }],
    }));
  return [...outputs, ...small(data.states, 'model'), ...small(data.inputs, 'quiet')];
}

/** `request` is the body of `/models/preview` without its system; `faulty` hears what is wrong with its documents. */
export function Preview({ request, system: first = '', faulty = () => {} }) {
  const { rows } = useSystems();
  const [system, setSystem] = useState(first);
  const [state, setState] = useState({ data: null, error: null });
  const [range, setRange] = useState(null);
  const body = { ...request, ...(system ? { system } : {}), max_points: 800 };
  const text = JSON.stringify(body);
  useEffect(() => {
    let left = false;
    const timer = setTimeout(
      () =>
        post('/models/preview', body).then(
          data => {
            if (!left) {
              setState({ data, error: null });
              faulty([]);
              setRange(null);
            }
          },
          error => {
            if (!left) {
              setState(before => ({ data: before.data, error }));
              faulty(error.errors);
            }
          },
        ),
      SETTLE_MS,
    );
    return () => {
      left = true;
      clearTimeout(timer);
    };
  }, [text]);
  const { data, error } = state;
  const time = useMemo(() => data?.time.map(seconds), [data]);
  const strips = useMemo(() => data && stripsOf(data), [data]);
  const says =
    data &&
    `${data.diverged ? 'It diverges. ' : ''}${Object.entries(data.outputs)
      .map(
        ([name, output]) =>
          `${name} runs from ${number(Math.min(...output.simulated.filter(value =>
            value !== null)))} to ${number(Math.max(...output.simulated.filter(value =>
              value !== null)))} ${output.unit}${output.rmse === null ? '' : `, rmse ${number(output.rmse)}`}`,
      )
      .join('; ')}.`;
  return html`<section><div class="row apart"><h2>What it does, with its nominal values</h2>
      <label class="inline">driven by <select value=${system} onChange=${event => setSystem(event.target.value)}><option
        value="">two standard days</option>
        ${(rows ?? []).map(row =>
          html`<option value=${row.system} selected=${row.system === system}>${row.system}, measured</option>`)}</select></label></div>
    ${error && ofDocument(error) && html`<p class="note">▲ The document has faults; this is what it did before.</p>`}
    ${error && !ofDocument(error) && html`<${Failed} error=${error} />`}
    ${!data && !error && html`<${Loading} what="the simulation" />`}
    ${
      data &&
      html`
      ${data.dropped.map(remark => html`<p class="note">Left out: ${remark}</p>`)}
      <${Frame} title="Simulation" summary=${says} note=${says}
        table=${() => ({ columns: [['time'], ...strips.flatMap(strip => strip.lines.map(line =>
          [`${strip.label} ${line.label} ${strip.unit}`, 'number']))], rows: data.time.map((at, row) => [at, ...strips.flatMap(strip =>
            strip.lines.map(line => (line.values[row] === null ? NONE : number(line.values[row], 5))))]) })}>
        <${Strips} time=${time} strips=${strips} whole=${[time[0], time.at(-1)]} range=${range} onZoom=${setRange} label=${says} /></${Frame}>
      <details><summary>curl</summary><${Command} text=${curl('/models/preview', { method: 'POST', body })} /></details>`
    }
  </section>`;
}
