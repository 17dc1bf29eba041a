// What a maximised likelihood says: its noise, where the local runs ended, and how sharply it is peaked in each parameter.
import { html } from '../html.js';
import { number, named, unitOf, NONE } from '../format.js';
import { useTitles } from '../parts/names.js';
import { Term } from '../parts/term.js';
import { Table } from '../parts/table.js';
import { Frame } from '../parts/frame.js';
import { Curve } from '../charts/curve.js';

const ORIGINS = { warm: 'a known point', cluster: 'the best of a cluster', random: 'a random place', profile: 'a better point of a profile' };
const interval = ci => (ci ? `${number(ci[0])} to ${number(ci[1])}` : NONE);

export function Likelihood({ fit }) {
  const found = fit.likelihood;
  if (!found) return null;
  const noises = [
    ...Object.entries(found.diffusion).map(([name, noise]) => [html`<${Term} of="diffusion">diffusion</${Term}> of ${name}`, noise]),
    ...Object.entries(found.measurement).map(([name, noise]) => [html`<${Term} of="sensor noise">sensor</${Term}> ${name}`, noise]),
  ];
  return html`<section>
    <h2>Likelihood</h2>
    <p><${Term} of="log-likelihood">Log-likelihood</${Term}> ${number(found.log_likelihood, 6)} over ${found.innovations} one-step <${Term} of="innovation">innovations</${Term}> with ${
      found.estimated} estimated numbers: <${Term} of="AIC">AIC</${Term}> ${number(found.aic, 6)}, <${Term} of="BIC">BIC</${Term}> ${number(found.bic, 6)}. ${found.exact ? 'The steps are exact.' : 'The filter is the extended one.'}</p>
    <${Table} caption="Noise" hidden columns=${[['noise'], ['value', 'number'], ['95 % interval', 'number'], ['']]}
      rows=${noises.map(([name, noise]) => [
        name,
        `${number(noise.value)} ${noise.unit}`,
        interval(noise.ci95),
        noise.at_bound ? '▲ at a bound: a limit, not an estimate' : '',
      ])} />
    <${Waterfall} fit=${fit} starts=${found.starts} reason=${found.reason} />
    <${Profiles} fit=${fit} found=${found} />
  </section>`;
}

/** The ends of the local runs, the best first. A flat stretch is an optimum that many starts agree on. */
function Waterfall({ fit, starts, reason }) {
  const sorted = starts.filter(start => start.to !== null).toSorted((a, b) => b.to - a.to);
  if (sorted.length === 0) return null;
  return html`<${Frame} title="Where the starts end" path=${`/fits/${fit.id}`} summary=${`${reason}.`}
    note="The best first: a flat stretch is an optimum that many starts agree on."
    table=${() => ({
      columns: [['rank', 'number'], ['start'], ['from', 'number'], ['to', 'number'], ['passes', 'number'], ['ended']],
      rows: sorted.map((start, at) => [
        at + 1,
        ORIGINS[start.origin],
        start.from === null ? NONE : number(start.from, 6),
        number(start.to, 8),
        start.passes,
        start.settled ? 'at an optimum' : 'short of it, or on the way of a better run',
      ]),
    })}>
    <${Curve} xLabel="local runs, the best first" yLabel="log-likelihood" label=${reason} across=${[1, Math.max(sorted.length, 2)]}
      at=${sorted.map((_, at) => at + 1)} lines=${[{ label: '', colour: 'model', points: sorted.map((start, at) => [at + 1, start.to]) }]} />
  </${Frame}>`;
}

/** The likelihood along each parameter, all others at their best. */
function Profiles({ fit, found }) {
  const titles = useTitles(fit.model);
  const entries = Object.entries(found.profiles);
  if (entries.length === 0) return null;
  const side = value => (value === null ? 'open' : number(value));
  const rows = entries.flatMap(([name, profile]) =>
    profile.values.map((value, at) => [name, number(value, 6), number(profile.log_likelihood[at], 8)]),
  );
  const open = entries.filter(([, profile]) => profile.ci95.includes(null)).map(([name]) => name);
  return html`<${Frame} title="Profile likelihoods" path=${`/fits/${fit.id}`}
    summary=${open.length ? `The likelihood does not fall on both sides of ${open.join(', ')}.` : 'Every parameter is enclosed.'}
    note="The largest log-likelihood below its peak, at each value of a parameter; 95 % lie above −1.92."
    table=${() => ({ columns: [['parameter'], ['value', 'number'], ['log-likelihood', 'number']], rows })}>
    <div class="small-multiples">${entries.map(([name, profile]) => {
      const peak = Math.max(...profile.log_likelihood);
      const ends = [profile.values[0], profile.values.at(-1)];
      const unit = unitOf(fit.parameters[name]?.unit ?? '');
      return html`<div><b>${named(name, titles)}</b> <small class="quiet">${side(profile.ci95[0])} to ${side(profile.ci95[1])} ${unit}</small>
        <${Curve} height=${130} xLabel=${unit} yLabel="" label=${`${name}: 95 % from ${side(profile.ci95[0])} to ${side(profile.ci95[1])}`}
          across=${ends} range=${[Math.min(-4, ...profile.log_likelihood.map(value => value - peak)), 0]}
          peaks=${fit.parameters[name] ? [{ x: fit.parameters[name].value, text: number(fit.parameters[name].value) }] : []}
          lines=${[
            { label: '', colour: 'model', open: true, points: profile.values.map((value, at) => [value, profile.log_likelihood[at] - peak]) },
            { label: '', colour: 'quiet', dash: '2 3', open: true, points: ends.map(x => [x, -1.92]) },
          ]} /></div>`;
    })}</div>
  </${Frame}>`;
}
