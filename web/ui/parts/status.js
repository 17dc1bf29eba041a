// A status is a shape, a word and a colour, so that none of them has to be seen.
import { html } from '../html.js';
import { words } from '../format.js';

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

/** A remark of the gate, such as `at_bound:c_solar`. */
export const Flag = ({ name }) =>
  html`<span class="flag ${name.startsWith('at_bound') ? 'bad' : ''}" title=${words(name)}>${words(name).replace(':', ': ')}</span>`;
