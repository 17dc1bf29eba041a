// A status is a shape, a word and a colour, so that none of them has to be seen.
import { html } from '../html.js';
import { words, WAITS } from '../format.js';

const LOOKS = {
  ok: ['●', 'ok'],
  fresh: ['●', 'ok'],
  succeeded: ['●', 'ok'],
  accepted: ['●', 'ok'],
  pass: ['●', 'ok'],
  named: ['●', 'ok'],
  adequate: ['●', 'ok'],
  attention: ['▲', 'warn'],
  fallback: ['▲', 'warn'],
  degraded: ['▲', 'warn'],
  held: ['▲', 'warn'],
  suggested: ['▲', 'warn'],
  not_enough_data: ['▲', 'warn'],
  bad: ['■', 'bad'],
  stale: ['■', 'bad'],
  failed: ['■', 'bad'],
  rejected: ['■', 'bad'],
  fail: ['■', 'bad'],
  pinned: ['◆', 'calm'],
  running: ['▶', 'calm'],
  queued: ['◷', 'quiet'],
  cancelled: ['✕', 'quiet'],
  unknown: ['○', 'quiet'],
  nominal: ['○', 'quiet'],
  unchanged: ['○', 'quiet'],
  none: ['○', 'quiet'],
};
const SAID = { bad: 'bad', none: 'nothing served', unknown: 'unknown', pass: 'passed', fail: 'failed' };

export function Status({ of, label }) {
  const [shape, tone] = LOOKS[of] ?? ['○', 'quiet'];
  return html`<span class="status ${tone}"><span class="shape" aria-hidden="true">${shape}</span> ${label ?? SAID[of] ?? words(of)}</span>`;
}

/** What the gate said of a fit, or that it waits for an operator. */
export const Verdict = ({ fit }) =>
  html`<${Status} of=${fit.waits_for_operator ? 'suggested' : (fit.verdict ?? 'unknown')} label=${fit.waits_for_operator ? WAITS : undefined} />`;

/**
 * The remarks of the gate, such as `at_bound:c_solar`, one mark for each kind, what lies at a bound first. `most` kinds
 * are shown; the marks say how many parameters they mean, and which, where one points.
 */
export function Flags({ of, most = Infinity }) {
  const kinds = new Map();
  for (const flag of [...of].sort((a, b) => b.startsWith('at_bound') - a.startsWith('at_bound'))) {
    const [kind, parameter] = flag.split(/:(.*)/);
    kinds.set(kind, [...(kinds.get(kind) ?? []), ...(parameter ? [parameter] : [])]);
  }
  const shown = [...kinds].slice(0, most);
  const left = [...kinds].slice(most).map(([kind]) => words(kind));
  return html`${shown.map(([kind, parameters]) => {
    const names = parameters.length ? `: ${parameters.join(', ')}` : '';
    const short = most < Infinity && parameters.length > 1 ? `: ${parameters.length}` : names;
    return html`<span class="flag ${kind === 'at_bound' ? 'bad' : ''}" title=${words(kind) + names}>${words(kind)}${short}</span>`;
  })}${left.length > 0 && html`<span class="quiet" title=${left.join(', ')}> +${left.length}</span>`}`;
}
