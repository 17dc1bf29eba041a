// The values, how sure they are, where their bounds lie; and what may be decided about them.
import { html, useState } from '../html.js';
import { useResource, useList, put, remove } from '../api.js';
import { REPORT } from '../carried.js';
import { useAfterJobs } from '../events.js';
import { setQuery } from '../router.js';
import { say, sayFault } from '../say.js';
import { number, fixed, clock, words, checkOf, operator, plainly, sentence, titleFor, unitOf, NONE } from '../format.js';
import { Check, Flags, Status, Verdict } from '../parts/status.js';
import { Parameter, useParameters, useTitles } from '../parts/names.js';
import { Term, explained } from '../parts/term.js';
import { Table } from '../parts/table.js';
import { Frame } from '../parts/frame.js';
import { Equations, Typeset } from '../parts/equations.js';
import { Shown, Empty } from '../parts/screens.js';
import { decision, Reason } from '../parts/dialog.js';
import { Rail } from '../charts/rail.js';
import { Curve } from '../charts/curve.js';
import { Correlations, isOf } from './correlations.js';
import { PlanExperiment } from './experiment.js';
import { Likelihood } from './likelihood.js';
import { Said } from './said.js';
import { States } from './states.js';

export function Parameters({ system, document, params, fit, reload }) {
  const chosen = useResource(fit && `/fits/${fit}`);
  const history = useList(`/params/${system}/history`);
  const changes = useResource(params && !REPORT ? `/systems/${system}/changes` : null);
  useAfterJobs(system, changes);
  const [asking, setAsking] = useState(null);
  const done = () => {
    reload();
    history.reload();
    chosen.reload();
  };
  if (!fit) return html`<${Empty} title="Never fitted"><p>There are no parameters yet. Press Refit.</p></${Empty}>`;
  return html`
    <${Served} params=${params} ask=${setAsking} system=${system} done=${done} />
    ${changes.data?.change && html`<p class="note"><${Term} of="change">Changed</${Term}>: ${changes.data.sentence}</p>`}
    <${Shown} of=${chosen} what="the fit" show=${data => html`
      <${Values} fit=${data} history=${history.data ?? []} change=${changes.data?.change} />
      ${!REPORT && params && html`<${PlanExperiment} fit=${data} system=${system} zone=${document.location?.zone ?? 'UTC'} />`}
      ${!REPORT && html`<${Mathematics} fit=${data} />`}
      <${Likelihood} fit=${data} />
      <${Judgement} fit=${data} ask=${setAsking} done=${done} />`} />
    <${States} system=${system} model=${params?.model ?? null} zone=${document.location?.zone ?? 'UTC'} />
    <${Said} system=${system} zone=${document.location?.zone ?? 'UTC'} />
    <${Shown} of=${history} what="the history" show=${list => html`<${History} system=${system} list=${list} ask=${setAsking} done=${done} />`} />
    ${asking && html`<${Reason} ...${asking} close=${() => setAsking(null)} />`}`;
}

function Served({ params, ask: asking, system, done }) {
  if (!params)
    return html`<p><${Status} of="none" label="Nothing is served: no fit was ever accepted. The controller gets a 404 and uses its own baseline." /></p>`;
  const hold = () =>
    asking({
      title: `Keep revision ${params.revision} in service`,
      text: 'Fits that the gate accepts meanwhile are suggested, not published.',
      word: 'Keep it',
      act: reason =>
        put(`/params/${system}/pin`, { reason }).then(() => {
          say('Kept');
          done();
        }),
    });
  const release = () =>
    remove(`/params/${system}/pin`).then(() => {
      say('Released: the next accepted fit is published');
      done();
    }, sayFault);
  return html`<section class="card row apart">
    <div><b>The controller gets revision ${params.revision}</b> <${Status}
      of=${params.status} help /> <${Flags} of=${params.flags} model=${params.model} />
      <p class="quiet">Fitted ${clock(params.fitted_at)}; stale after ${clock(params.stale_after)}.
      ${params.fallback ? ` ${words(params.fallback.reason)} since ${clock(params.fallback.since)}${params.fallback.failed_checks?.length ?
        `: ${params.fallback.failed_checks.map(check => checkOf(check).name).join(', ')}` : ''}.` : ''}
      ${params.pin ? ` Kept since ${clock(params.pin.since)}: ${params.pin.reason}.` : ''}</p></div>
    ${params.pin ? html`<button onClick=${release}>Release it</button>` : html`<button onClick=${hold}>Keep it in service (pin)</button>`}
  </section>`;
}

export function Values({ fit, history, change }) {
  const { titles, scaleOf } = useParameters(fit.model);
  const before = history.find(revision => revision.fit !== fit.id)?.parameters ?? {};
  const entries = Object.entries(fit.parameters);
  const interval = ci => (ci ? `${number(ci[0])} to ${number(ci[1])}` : NONE);
  const known = name => fit.prior?.parameters[name];
  const knownBefore = (name, unit) => {
    const { value, deviation } = known(name);
    const spread = scaleOf(name) === 'log' ? html`within a factor of ${number(Math.exp(deviation))}` : html`± ${number(deviation)} ${unitOf(unit)}`;
    return html`<br /><small class="quiet">${fit.prior.from?.length ? 'others in the building' : 'known before'}: ${number(value)}, ${spread}</small>`;
  };
  return html`<${Frame} title=${`Parameters of ${fit.model}`} path=${`/fits/${fit.id}`} drawn=${false}
    summary=${`${entries.filter(([, entry]) => entry.at_bound).length} of ${entries.length} lie at a bound.`}
      table=${() => ({ columns: [['parameter'], ['what it is'], ['value', 'number'], ['low', 'number'], ['high', 'number'],
        ['lower bound', 'number'], ['upper bound', 'number'], ['unit'], ['known before', 'number'], ['its deviation', 'number']], rows: entries.map(([name, entry]) => [name, titleFor(name, titles) ?? '', number(entry.value, 6), number(entry.ci95?.[0],
          6), number(entry.ci95?.[1], 6), entry.bounds[0], entry.bounds[1], entry.unit, known(name)?.value, known(name)?.deviation]) })}>
    <${Table} caption="Parameters" hidden
      columns=${[['parameter'], ['value', 'number'], ['95 % interval', 'number'], ['between its bounds'], ['bounds', 'number'],
        ...(history.length ? [['since before', 'number'], ['history']] : [])]}
      rows=${entries.map(([name, entry]) => [
        html`<${Parameter} symbol=${name} titles=${titles} />`,
        html`<b title=${entry.value}>${number(entry.value)}</b> ${unitOf(entry.unit)}${entry.fixed ? ' (fixed)' : ''}${known(name) ? knownBefore(name, entry.unit) : ''}`,
        html`<span title=${entry.ci95?.join(' to ')}>${interval(entry.ci95)}</span> ${entry.ci95 ? unitOf(entry.unit) : ''}`,
        html`<${Rail} value=${entry.value} interval=${entry.ci95} bounds=${entry.bounds} log=${scaleOf(name) === 'log'}
          atBound=${entry.at_bound} />
          ${entry.at_bound ? html`<${Status} of="bad" label=${html`<${Term} of="at bound">at bound</${Term}>`} />` : ''}`,
        html`${number(entry.bounds[0])} to ${number(entry.bounds[1])} ${unitOf(entry.unit)}<br /><small class="quiet">
          ${scaleOf(name) === 'log' ? explained('logarithmic') : 'linear'}</small>`,
        ...(history.length
          ? [
              before[name] === undefined ? NONE : `${entry.value >= before[name] ? '+' : '−'}${number(Math.abs(entry.value - before[name]))} ${unitOf(entry.unit)}`,
              html`<${OfRevisions} name=${name} history=${history} unit=${entry.unit} since=${change?.parameter === name ? change.since : null} />`,
            ]
          : []),
      ])} />
    ${fit.remarks.filter(remark => !fit.correlated.some(pair => isOf(pair, remark))).map(remark => html`<p class="note">${plainly(remark, { titles })}</p>`)}
  </${Frame}>
  <${Correlations} fit=${fit} />`;
}

/** What the parameters stand in: the documents' own words, and the equations as this fit has them. */
function Mathematics({ fit }) {
  const model = useResource(`/models/${encodeURIComponent(fit.model)}`);
  return html`<section><h2>Equations of ${fit.model}</h2>
    <${Equations} model=${fit.model} />
    ${model.data && html`<${Typeset} path=${`/fits/${fit.id}/model`} states=${model.data.states.length} />`}</section>`;
}

/** A parameter over the revisions, in its cell; the chart opens. */
function OfRevisions({ name, history, unit, since }) {
  const points = history
    .filter(revision => revision.parameters[name] !== undefined)
    .map(revision => [revision.revision, revision.parameters[name], revision.ci95[name]]);
  if (points.length < 2) return html`<span class="quiet">one revision</span>`;
  // The first revision that had seen days behind the change.
  const seen = since ? history.filter(revision => Date.parse(revision.to) > Date.parse(since)).map(revision => revision.revision) : [];
  const peaks = seen.length > 0 ? [{ x: Math.min(...seen), text: `since ${since.slice(0, 10)}` }] : [];
  const bound = at => points.filter(([, , ci]) => ci).map(([revision, , ci]) => [revision, ci[at]]);
  return html`<details><summary>${points.length} revisions</summary>
    <${Curve} height=${130} xLabel="revision" yLabel=${unit} label=${`${name} over ${points.length} revisions`} peaks=${peaks} lines=${[
      { label: name, colour: 'model', points: points.map(([x, y]) => [x, y]) },
      { label: '95 %', colour: 'quiet', dash: '2 3', points: bound(0) },
      { label: '', colour: 'quiet', dash: '2 3', points: bound(1) },
    ]} /></details>`;
}

export function Judgement({ fit, ask: asking, done }) {
  const titles = useTitles(fit.model);
  const summary = plainly(fit.summary, { titles });
  const decide = (word, title) => () => asking(decision(fit, word, { title, text: `${fit.model}, ${summary}`, done }));
  return html`<section>
    <div class="row apart"><h2>What the <${Term} of="gate">gate</${Term}> says: <${Verdict} fit=${fit} /></h2>
      ${fit.waits_for_operator && html`<span class="row"><button class="main"
        onClick=${decide('promote', 'Promote to the controller')}>Promote</button><button
          onClick=${decide('reject', 'Reject this fit')}>Reject</button></span>`}</div>
    <p>${sentence(summary)}.${fit.decision ?
      ` ${words(fit.decision.decision)} on ${clock(fit.decision.decided_at)}: ${fit.decision.reason}.` : ''}</p>
    <${Table} caption="Checks" columns=${[['check'], ['result'], ['statistic', 'number'], ['asked for', 'number'], ['what it means']]}
      rows=${fit.checks.map(check => [
        html`<${Check} name=${check.name} />`,
        html`<span class="nowrap"><${Status} of=${check.pass ? 'pass' : check.severity === 'reject' ? 'fail' : 'attention'}
          label=${check.pass ? 'passed' : check.severity === 'reject' ? 'failed' : `${check.severity}s`} /></span>`,
        html`<span title=${check.statistic}>${number(check.statistic)}</span> ${unitOf(check.unit)}`,
        check.threshold === null ? NONE : `${operator(check.operator)} ${number(check.threshold)} ${unitOf(check.unit)}`,
        plainly(check.comment, { titles }),
      ])} />
  </section>`;
}

function History({ system, list, ask: asking, done }) {
  const roll = revision => () =>
    asking({
      title: `Roll back to revision ${revision.revision}`,
      text: 'A new revision is made that names the old fit; it stays in service until the pin is released.',
      word: 'Roll back',
      act: reason =>
        put(`/params/${system}/pin`, { reason, fit: revision.fit }).then(() => {
          say('Rolled back');
          done();
        }),
    });
  return html`<h2>Revisions</h2>${
    list.length === 0
      ? html`<p class="quiet">Nothing was ever served.</p>`
      : html`<${Table} caption="Revisions" hidden
    columns=${[['revision'], ['published'], ['model'], ['cause'], ['24 h ahead', 'number'], ['validation', 'number'], ['reason'], ['']]}
    rows=${list.map(revision => {
      const errors = Object.entries(revision.error);
      const of = key =>
        errors.map(([name, error]) => html`<div class="nowrap">${errors.length > 1 ? `${name} ` : ''}${fixed(key(error))} ${error.unit}</div>`);
      return [
        html`<button class="plain" onClick=${() => setQuery({ fit: revision.fit })}>
          ${revision.revision}${revision.current ? ', served' : ''}</button>`,
        clock(revision.published_at),
        revision.model,
        revision.cause,
        errors.some(([, error]) => error.ahead?.PT24H !== undefined) ? of(error => error.ahead?.PT24H) : NONE,
        of(error => error.validation_rmse),
        revision.reason ?? NONE,
        revision.current ? '' : html`<button onClick=${roll(revision)}>Roll back</button>`,
      ];
    })} />`
  }`;
}
