// A job as it goes, pushed by the service: how far it is, how the error falls, where the parameters are.
import { html, useEffect, useRef, useState } from '../html.js';
import { useResource, post } from '../api.js';
import { address } from '../router.js';
import { useJob, hasEnded } from '../events.js';
import { say, sayFault } from '../say.js';
import { number, length, plainly, roughly, percent, unitOf } from '../format.js';
import { Status } from './status.js';
import { Parameter, useTitles } from './names.js';
import { explained } from './term.js';
import { Frame } from './frame.js';
import { Failed, Loading } from './screens.js';
import { Curve } from '../charts/curve.js';
import { Rail } from '../charts/rail.js';

/** The cost of a mean square is shown as its root, which has the unit of the output. */
const shownCost = job => (job.request.objective === 'mse' ? [Math.sqrt, 'rmse'] : [cost => cost, 'cost']);

/** The lines of the search: from its reports while it runs, from the stored trace afterwards. */
function linesOf(job, reports, fit) {
  const [shown] = shownCost(job);
  // The trace has its improvements only; the best stayed the best until the end.
  const stored = fit?.trace?.length
    ? [...fit.trace, { evaluations: Math.max(job.evaluations ?? 0, fit.trace.at(-1).evaluations), best: fit.trace.at(-1).best }]
    : null;
  const trace = stored
    ? stored.map(({ evaluations, best }) => [evaluations, shown(best)])
    : reports.filter(report => report.best_train !== null).map(report => [report.evaluations, shown(report.best_train)]);
  const validation = reports.filter(report => report.best_validation !== null).map(report => [report.evaluations, report.best_validation]);
  return [
    { label: 'train', colour: 'measured', points: trace },
    ...(validation.length ? [{ label: 'validation', colour: 'model', dash: '6 4', points: validation }] : []),
  ];
}

/** Who leads the trials of a round, and what it gains. */
function leads({ leader, fall, gain }) {
  if (!leader) return 'none';
  const on = share => (share < 0.995 ? `${percent(1 - share)} less error on unseen data` : 'no less error on unseen data');
  return `${leader}: ${Number.isFinite(fall) ? on(fall) : `gains ${number(gain)} in BIC`}`;
}

/** The time that is left, as of the newest report; it goes on between two of them. */
function TimeLeft({ report, most }) {
  const [, setTurn] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => setTurn(turn => turn + 1), 1000);
    return () => clearInterval(timer);
  }, []);
  if (report.eta_s === null) return 'not known yet';
  const left = roughly(Math.max(report.eta_s - (Date.now() - report.at) / 1000, 0));
  return most || left.startsWith('a ') ? left : `about ${left}`;
}

export function JobWatch({ id, title, onEnd = () => {} }) {
  const { job, reports, incumbent, error } = useJob(id);
  const fit = useResource(job?.fit ? `/fits/${job.fit}` : null);
  const model = useResource(job ? `/models/${encodeURIComponent(job.model)}` : null);
  const titles = useTitles(job?.model);
  const ran = useRef(false);
  const told = useRef(false);
  useEffect(() => {
    if (!job || told.current) return;
    if (!hasEnded(job)) {
      ran.current = true;
      return;
    }
    told.current = true;
    if (ran.current) say(`${title ?? job.kind}: ${job.outcome ?? job.state}`);
    onEnd(job);
  }, [job]);
  if (error) return html`<${Failed} error=${error} />`;
  if (!job) return html`<${Loading} what="the job" />`;
  const last = reports.at(-1);
  const ended = hasEnded(job);
  const evaluations = ended ? job.evaluations : (last?.evaluations ?? job.progress?.evaluations);
  // The budget of a tuning is that of each of its searches.
  // With its trials a diagnosis counts effects, and its fit has spent its budget.
  const trials = ended ? null : (last ?? job.progress)?.trials;
  const budget = job.kind === 'tune' || trials ? null : job.request.budget?.evaluations;
  const [, costName] = shownCost(job);
  const lines = linesOf(job, reports, fit.data);
  const cancel = () => post(`/jobs/${id}/cancel`).then(() => say('Cancelled'), sayFault);
  const values = fit.data ? Object.fromEntries(Object.entries(fit.data.parameters).map(([name, entry]) => [name, entry.value])) : incumbent;
  return html`<section class="card" aria-label=${title ?? job.kind}>
    <div class="row apart"><h3><${Status} of=${job.state} /> ${title ?? job.kind} <a class="quiet" href=${address(['jobs', id])}>${id}</a></h3>
      ${!ended && html`<button onClick=${cancel}>Stop</button>`}</div>
    <dl class="figures">
      <div><dt>${explained('evaluations')}</dt><dd>${evaluations ?? '–'}${budget && !ended ? ` of at most ${budget}` : ''}</dd></div>
      ${last && !ended && !trials && html`<div><dt>${explained('generation')}</dt><dd>${last.generation}</dd></div>`}
      ${trials && html`<div><dt>effects tried</dt><dd>${trials.of ? `${trials.tried} of ${trials.of}${trials.round > 1 ? `, round ${trials.round}` : ''}` : 'none yet'}</dd></div>
        <div><dt>leads so far</dt><dd>${leads(trials)}</dd></div>`}
      ${last && !ended && html`<div><dt>time left${trials ? '' : ', at most'}</dt><dd><${TimeLeft} report=${last} most=${!trials} /></dd></div>`}
      ${ended && html`<div><dt>ran for</dt><dd>${length(job.wall_s)}</dd></div><div><dt>${explained('stopped because')}</dt><dd>
        ${plainly(job.stopped_by ?? job.error?.detail ?? job.state)}</dd></div>`}
      ${ended && fit.data?.searched && html`<div><dt>searched</dt><dd>${fit.data.searched === 'local' ? 'next to what was served' : 'everywhere'}</dd></div>`}
      ${last?.best_train != null && html`<div><dt>${explained('best on train')}</dt><dd>${number(shownCost(job)[0](last.best_train))}</dd></div>`}
      ${last?.best_validation != null && html`<div><dt>${explained('best on validation')}</dt><dd>${number(last.best_validation)}</dd></div>`}
    </dl>
    ${!ended && html`<progress max=${budget ?? 1} value=${trials ? (trials.share ?? undefined) : budget ? (evaluations ?? 0) : undefined}
      aria-label=${trials ? 'Share of the work that is done' : 'Evaluations of the budget'}></progress>`}
    ${job.error && html`<p><${Status} of="failed" label=${job.error.detail} /></p>`}
    <div class="grid">
      ${
        lines[0].points.length > 0 &&
        html`<${Frame} title="How the error falls" path=${job.fit ? `/fits/${job.fit}` : `/jobs/${id}/events`}
          summary=${`After ${evaluations} evaluations the best error on train is ${number(lines[0].points.at(-1)?.[1])}.`}
        table=${() => ({ columns: [['line'], ['evaluations', 'number'], [costName, 'number']], rows: lines.flatMap(line =>
          line.points.map(([x, y]) => [line.label, x, number(y, 5)])) })}>
        <${Curve} lines=${lines} log xLabel="evaluations" yLabel=${costName} label="The error of the best candidate over the evaluations" />
          </${Frame}>`
      }
      ${
        values &&
        model.data &&
        html`<div class="scroll" tabindex="0" role="region" aria-label="Parameters"><table><caption>Parameters${ended ? '' : ', live'}
          </caption><tbody>${Object.entries(
          values,
        ).map(([name, value]) => {
          const known = model.data.parameters.find(parameter => parameter.name === name);
          const found = fit.data?.parameters[name];
          const bounds = found?.bounds ?? job.request.bounds?.[name] ?? known?.bounds;
          return html`<tr><th scope="row"><${Parameter} symbol=${name} titles=${titles} /></th><td class="number">${number(value)} ${unitOf(known?.unit ?? '')}</td>
          <td>${bounds && html`<${Rail} value=${value} bounds=${bounds} interval=${found?.ci95} log=${known?.scale === 'log'}
            atBound=${found?.at_bound} />`}</td></tr>`;
        })}</tbody></table></div>`
      }
    </div>
  </section>`;
}
