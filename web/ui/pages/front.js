// The front of a system for whoever runs it: what it is now, what comes, and how yesterday's forecast did.
import { html } from '../html.js';
import { useResource, withQuery } from '../api.js';
import { useAfterJobs } from '../events.js';
import { number, fixed, seconds, instant, fromNow, clock, horizon, hoursOf, percent, NONE } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Loading } from '../parts/screens.js';
import { forecasts, outputIn } from '../parts/outputs.js';
import { Curve } from '../charts/curve.js';
import { linesOf } from '../charts/lines.js';

const DAY_S = 24 * 3600;
const POINTS = 400;
const MOST_NAMES = 3;
/** The half of a band that holds 95 of 100, in standard deviations. */
const BAND = 1.96;
const few = names =>
  names.length > MOST_NAMES ? `${names.slice(0, MOST_NAMES).join(', ')} and ${names.length - MOST_NAMES} more` : names.join(' and ');

/** The last sample of a line that has a value, or -1. */
const lastKnown = values => values.findLastIndex(value => value !== null && value !== undefined);
/** One value for each point of a line that may be thinned. */
const middle = line => {
  const { values, min, max } = linesOf(line);
  return values ?? min.map((low, at) => (low === null ? null : (low + max[at]) / 2));
};

export function Front({ system, fit, metrics, params, document, query }) {
  const windows = useResource(`/systems/${system}/windows?page_size=1`);
  const kept = useResource(`/systems/${system}/forecast/inputs`);
  const scores = useResource(`/systems/${system}/forecast/scores`);
  const to = windows.data?.items[0]?.to ?? null;
  const ahead = forecasts(metrics);
  const past = useResource(
    to &&
      withQuery(`/fits/${fit}/comparison`, {
        ...(ahead ? { mode: 'ahead', horizon: 'PT24H' } : { mode: 'free_run' }),
        from: instant(seconds(to) - DAY_S),
        to,
        max_points: POINTS,
      }),
  );
  const name = outputIn(query, metrics);
  const output = past.data?.outputs[name];
  const at = output ? lastKnown(middle(output.measured)) : -1;
  const newest = at >= 0 ? past.data.time[at] : to;
  const reach = past.data && kept.data && newest ? reachOf(past.data, kept.data, windows.data.items[0], newest) : null;
  const zone = document.location?.zone ?? 'UTC';
  const why = whyNone({ params, ahead, reach, zone });
  const coming = withQuery(`/systems/${system}/forecast`, { horizon: reach && `PT${Math.min(reach.hours, 24)}H` });
  const next = useResource(reach && !why ? coming : null);
  useAfterJobs(system, windows, scores, next);
  return html`<section class="front" aria-label="At a glance">
    <div>
      <dl class="figures">
        <div><dt>${name ?? 'output'}, newest</dt><dd>${output && at >= 0 ? `${number(middle(output.measured)[at])} ${output.unit}` : NONE}</dd></div>
        <div><dt>measured</dt><dd title=${clock(newest, zone)}>${fromNow(newest)}</dd></div>
      </dl>
      <p>${fares({ name, metrics, params, past: past.data, scores: scores.data })}</p>
      ${(why || next.error) && html`<p class="quiet">${why ?? `No forecast: ${next.error.errors?.[0]?.detail ?? next.error.detail}.`}</p>`}
    </div>
    <div>${past.loading && !past.data && html`<${Loading} what="the last day" />`}${output && html`<${Days} name=${name} unit=${output.unit} past=${past.data} newest=${newest} zone=${zone} ahead=${ahead}
      to=${next.data?.outputs[name] ? next.data : null} path=${next.data ? coming : null} />`}</div>
  </section>`;
}

/** Why nothing is forecast, in a sentence; null where something is, or nobody knows yet. */
function whyNone({ params, ahead, reach, zone }) {
  if (!params) return 'No forecast: nothing is served whose model could make one.';
  if (!ahead) return 'No forecast: this model has no filter that could follow the measurements.';
  if (!reach || reach.hours >= 1) return null;
  const theirs = reach.names.length > 1 ? 'their forecasts' : 'its forecast';
  return `No forecast: nothing is known of ${few(reach.names)} after ${clock(reach.until, zone)}. Upload ${theirs} for the hours to come.`;
}

/**
 * How many hours behind the newest measurement every input is known, and which end first. What the service computes
 * itself never ends.
 */
function reachOf(past, kept, newestWindow, newest) {
  const ends = Object.entries(past.inputs).flatMap(([name, line]) => {
    const forecast = kept.find(entry => entry.channel === name);
    const measured = name in newestWindow.channels;
    if (!forecast && !measured) return [];
    const last = lastKnown(middle(line));
    return [[name, Math.max(last >= 0 ? seconds(past.time[last]) : 0, forecast ? seconds(forecast.to) : 0)]];
  });
  const first = Math.min(...ends.map(([, end]) => end), seconds(newest) + DAY_S);
  const hours = Math.floor((first - seconds(newest)) / 3600);
  return { hours, until: instant(first), names: ends.filter(([, end]) => end - seconds(newest) < 3600).map(([name]) => name) };
}

/** One sentence: how well forecasts of a day have done. */
function fares({ name, metrics, params, past, scores }) {
  const said = scores?.outputs[name]?.leads.findLast(lead => lead.n > 0 && hoursOf(lead.lead) <= 24);
  if (said)
    return `What it said ${horizon(said.lead)} ahead was wrong by ${fixed(said.rmse)} ${scores.outputs[name].unit}, and ${percent(said.within95)}
      of what came lay in its band; holding the last value errs by ${fixed(said.persistence)}.`;
  const yesterday = past?.mode === 'ahead' ? past.errors[name]?.range : null;
  const usual = metrics[name]?.ahead?.PT24H;
  const unit = metrics[name]?.unit;
  if (yesterday?.n && usual)
    return `Over the last day forecasts made 24 h before err by ${fixed(yesterday.rmse)} ${unit}; on unseen data they usually err by
      ${fixed(usual.rmse)} ${unit}, holding the last value by ${fixed(usual.persistence)}.`;
  if (metrics[name]) return `On unseen data its free run errs by ${fixed(metrics[name].validation_rmse)} ${unit}.`;
  return params ? 'Nothing is known of its errors yet.' : 'Nothing was fitted yet.';
}

/** A day back, measured and as it was forecast the day before, and a day to come with its band of 95 %. */
function Days({ name, unit, past, newest, to, ahead, path, zone }) {
  const from = seconds(newest);
  const hours = time => (seconds(time) - from) / 3600;
  const line = (time, values) =>
    time.map((at, row) => [hours(at), values[row]]).filter(([, value]) => value !== null && value !== undefined);
  const measured = line(past.time, middle(past.outputs[name].measured));
  const before = line(past.time, middle(past.outputs[name].simulated));
  const { values = [], sd = [] } = to?.outputs[name] ?? {};
  const come = line(to?.time ?? [], values);
  const band = values.map((value, row) => [hours(to.time[row]), ...[-1, 1].map(side => value + side * BAND * sd[row])]);
  const all = [...measured, ...before, ...come].map(([, value]) => value).concat(band.flatMap(([, low, high]) => [low, high]));
  const title = `The last day: ${ahead ? 'forecast' : 'model'} and measured${to ? ', and the hours to come' : ''}`;
  const labels = [ahead ? 'said a day before' : 'model', `next ${Math.round(come.at(-1)?.[0] ?? 0)} h, band 95 %`];
  const says = `${name} in ${unit}, hours from ${clock(newest, zone)} (${zone})`;
  const rows = () => {
    const at = new Map();
    const put = (points, column) => points.forEach(([hour, ...values]) => at.set(hour, { ...at.get(hour), [column]: values }));
    put(measured, 'measured');
    put(before, 'before');
    put(come, 'come');
    put(band, 'band');
    return [...at].sort(([a], [b]) => a - b).map(([hour, entry]) => [
      instant(from + hour * 3600),
      ...['measured', 'before', 'come'].map(column => number(entry[column]?.[0], 5)),
      ...[0, 1].map(side => number(entry.band?.[side], 5)),
    ]);
  };
  return html`<${Frame} title=${title} path=${path ?? `/fits/${past.fit}/comparison`} summary=${says}
    table=${() => ({
      columns: [['time'], ...['measured', labels[0], 'to come', 'low', 'high'].map(column => [column, 'number'])],
      rows: rows(),
    })}>
    <${Curve} height=${110} label=${says} xLabel=${`hours from ${clock(newest, zone)}`} yLabel=""
      across=${[-24, come.length ? 24 : 0]} at=${come.length ? [-24, -12, 0, 12, 24] : [-24, -18, -12, -6, 0]}
      range=${[Math.min(...all), Math.max(...all)]} band=${band}
      lines=${[
        { label: 'measured', colour: 'measured', open: true, points: measured },
        { label: labels[0], colour: 'previous', dash: '2 3', open: true, points: before },
        ...(come.length ? [{ label: labels[1], colour: 'model', dash: '8 3', open: true, points: come }] : []),
      ]} /></${Frame}>`;
}
