// What forecasts said, beside what came: the error by how far ahead they looked.
import { html } from '../html.js';
import { useResource } from '../api.js';
import { useAfterJobs } from '../events.js';
import { number, signed, percent, horizon, hoursOf, clock } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Empty, Shown } from '../parts/screens.js';
import { Curve } from '../charts/curve.js';

const TITLE = 'What it said, and what came';
const COLUMNS = [['ahead'], ['forecasts', 'number'], ['rmse', 'number'], ['holding the last value', 'number'], ['bias', 'number'], ['in the 95 % band', 'number']];

export function Said({ system, zone }) {
  const path = `/systems/${system}/forecast/scores`;
  const scores = useResource(path);
  useAfterJobs(system, scores);
  return html`<h2>${TITLE}</h2><${Shown} of=${scores} what="the forecasts" show=${data => {
    const outputs = Object.entries(data.outputs).filter(([, { leads }]) => leads.some(row => row.n > 0));
    if (data.forecasts === 0)
      return html`<${Empty} title="No forecasts yet"><p>Nobody has asked for a forecast of this system in the last thirty days. Those that are asked for
        are kept, and compared with what comes.</p></${Empty}>`;
    if (outputs.length === 0)
      return html`<${Empty} title="Nothing has come yet"><p>${said(data, zone)}. The first can be compared as soon as measurements of an hour later are
        uploaded.</p></${Empty}>`;
    return outputs.map(([output, scored]) => html`<${Output} key=${output} output=${output} ...${scored} path=${path} says=${said(data, zone)} />`);
  }} />`;
}

const said = ({ forecasts, from, to, revisions }, zone) =>
  `${forecasts} ${forecasts === 1 ? 'forecast' : 'forecasts'} from ${clock(from, zone)} to ${clock(to, zone)} (${zone}), by revision ${revisions.join(', ')}`;

function Output({ output, unit, leads, path, says }) {
  const rows = leads.filter(row => row.n > 0);
  const last = rows.at(-1);
  const line = (label, colour, dash, of) => ({ label, colour, dash, points: rows.map(row => [hoursOf(row.lead), of(row)]) });
  return html`<${Frame} title=${`Error of what was said, ${output}`} path=${path}
    summary=${`${horizon(last.lead)} ahead the error is ${number(last.rmse)} ${unit}; holding the last value errs by ${number(last.persistence)} ${unit}.`}
    note=${`${says}. Forecasts of neighbouring quarters of an hour err together: few days say little.`}
    table=${() => ({
      columns: COLUMNS,
      rows: leads.map(row => [row.lead, row.n, row.rmse, row.persistence, row.bias, row.within95]),
    })}>
    <${Curve} label=${`Error of what was said of ${output}, by hours ahead`} xLabel="hours ahead" yLabel=${`rmse in ${unit}`}
      range=${[0, Math.max(...rows.flatMap(row => [row.rmse, row.persistence])) || 1]}
      lines=${[
        line('said', 'model', null, row => row.rmse),
        line('holding the last value', 'previous', '6 3', row => row.persistence),
      ]} />
    <${Table} caption=${says} hidden columns=${COLUMNS} rows=${rows.map(row => [
      horizon(row.lead),
      row.n,
      `${number(row.rmse)} ${unit}`,
      `${number(row.persistence)} ${unit}`,
      `${signed(row.bias)} ${unit}`,
      percent(row.within95),
    ])} /></${Frame}>`;
}
