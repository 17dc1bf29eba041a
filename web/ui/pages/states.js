// The states now: what a controller begins its forecasts from.
import { html } from '../html.js';
import { useResource } from '../api.js';
import { useAfterJobs } from '../events.js';
import { number, clock, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Empty, Shown } from '../parts/screens.js';

const SHOWN = 12;
const COLUMNS = [['state'], ['value', 'number'], ['deviation', 'number'], ['unit']];

/** `model` is that of the revision which is served, null where none is. */
export function States({ system, model, zone }) {
  const path = `/systems/${system}/state`;
  const state = useResource(model && path);
  const spec = useResource(model && `/models/${encodeURIComponent(model)}`);
  useAfterJobs(system, state);
  if (!model || state.error?.type === 'no-state')
    return html`<h2>The states now</h2><${Empty} title="No states yet"><p>Nothing is served whose model could tell them. They come with the first
      fit that is accepted.</p></${Empty}>`;
  return html`<h2>The states now</h2><${Shown} of=${state} what="the states" show=${({ at, states: values, sd, revision, free_run: isFree }) => {
    const unitOf = Object.fromEntries((spec.data?.states ?? []).map(entry => [entry.name, entry.unit]));
    const rows = Object.entries(values).map(([name, value]) => [name, number(value, 4), number(sd[name], 2), unitOf[name] ?? NONE]);
    const says = `${rows.length} states at ${clock(at, zone)} (${zone}), by revision ${revision}${isFree ? ', of a free run, which no measurement has corrected' : ''}`;
    return html`<${Frame} title="States at the newest sample" path=${path} drawn=${false} summary=${says}
      note=${`${says}.${rows.length > SHOWN ? ` The first ${SHOWN} are shown; the table has all.` : ''}`}
      table=${() => ({
        columns: COLUMNS,
        rows: Object.entries(values).map(([name, value]) => [name, number(value, 6), number(sd[name], 6), unitOf[name] ?? NONE]),
      })}>
      <${Table} caption=${says} hidden columns=${COLUMNS} rows=${rows.slice(0, SHOWN)} /></${Frame}>`;
  }} />`;
}
