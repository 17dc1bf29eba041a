// A status is a shape, a word and a colour, so that none of them has to be seen.
import { html } from '../html.js';
import { words, checkOf, named, WAITS } from '../format.js';
import { useTitles } from './names.js';
import { Term } from './term.js';

const LOOKS = {
  ok: ['●', 'ok'],
  fresh: ['●', 'ok'],
  succeeded: ['●', 'ok'],
  accepted: ['●', 'ok'],
  pass: ['●', 'ok'],
  adequate: ['●', 'ok'],
  attention: ['▲', 'warn'],
  named: ['▲', 'warn'],
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

/** `help` says what it means, `quiet` where it repeats in every row; not inside of a link or a button. */
export function Status({ of, label, help = false }) {
  const [shape, tone] = LOOKS[of] ?? ['○', 'quiet'];
  const said = label ?? SAID[of] ?? words(of);
  return html`<span class="status ${tone}"><span class="shape" aria-hidden="true">${shape}</span> ${
    help && LOOKS[of] ? html`<${Term} of=${words(of)} quiet=${help === 'quiet'}>${said}</${Term}>` : said
  }</span>`;
}

/** A check of the gate by its name; what its rule asks, and the code, are behind it. */
export function Check({ name }) {
  const check = checkOf(name);
  return check.rule ? html`<${Term} of=${check.rule} code=${name}>${check.name}</${Term}>` : check.name;
}

/** What the gate said of a fit, or that it waits for an operator. */
export const Verdict = ({ fit }) =>
  html`<${Status} of=${fit.waits_for_operator ? 'suggested' : (fit.verdict ?? 'unknown')} label=${fit.waits_for_operator ? WAITS : undefined} help />`;

/**
 * The remarks of the gate, such as `at_bound:c_solar`, one mark for each kind, what lies at a bound first. `model` has the
 * titles of the parameters. `brief` marks say how many of several they mean; in a list `most` kinds are shown, and are no
 * stops of the Tab key.
 */
export function Flags({ of, model = null, most = Infinity, brief = false }) {
  const titles = useTitles(of.length > 0 ? model : null);
  const listed = most < Infinity;
  const kinds = new Map();
  for (const flag of [...of].sort((a, b) => b.startsWith('at_bound') - a.startsWith('at_bound'))) {
    const [kind, parameter] = flag.split(/:(.*)/);
    kinds.set(kind, [...(kinds.get(kind) ?? []), ...(parameter ? [parameter] : [])]);
  }
  const shown = [...kinds].slice(0, most);
  const left = [...kinds].slice(most).map(([kind]) => words(kind));
  return html`${shown.map(([kind, parameters]) => {
    const names = listed ? '' : parameters.map(parameter => named(parameter, titles)).join(', ');
    const which = (brief || listed) && parameters.length > 1 ? String(parameters.length) : names;
    return html`<${Term} class="flag ${kind === 'at_bound' ? 'bad' : ''}" of=${words(kind)} quiet=${listed}
      code=${[kind, parameters.join(', ')].filter(Boolean).join(': ')}>${[words(kind), which].filter(Boolean).join(': ')}</${Term}>`;
  })}${left.length > 0 && html`<span class="quiet" title=${left.join(', ')}> +${left.length}</span>`}`;
}
