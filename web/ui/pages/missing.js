// Which physical effect the model lacks: the ranked findings, and what happens when one is added.
import { html, useState } from '../html.js';
import { useResource, useList, post } from '../api.js';
import { setQuery, address, systemAddress } from '../router.js';
import { REPORT } from '../carried.js';
import { hasEnded, useAfterJobs } from '../events.js';
import { sayFault } from '../say.js';
import { number, percent, horizon, clock, signed, fixed, chance, sentence, NONE } from '../format.js';
import { Status } from '../parts/status.js';
import { Parameter, useTitles } from '../parts/names.js';
import { Term } from '../parts/term.js';
import { Frame } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Failed, Loading, Empty } from '../parts/screens.js';
import { JobWatch } from '../parts/watch.js';
import { Bars } from '../charts/bars.js';
import { worstOutput } from '../parts/outputs.js';
import { Adding } from './adding.js';
import { Evidence } from './evidence.js';
import { Ledger } from './ledger.js';
import { MissingHeat } from './missing-heat.js';
import { Proposals } from './proposals.js';

const SAYS = {
  named: 'Something physical is missing here, and it has a name.',
  adequate: 'Nothing is missing: what is left of the error looks like noise.',
  unknown: 'Something is missing that none of the known effects explains.',
  not_enough_data: 'These data cannot say what is missing.',
};

export function Missing({ system, document, metrics, query, reload, changed }) {
  const diagnoses = useList(`/diagnoses?system=${encodeURIComponent(system)}`);
  const jobs = useList(`/jobs?system=${encodeURIComponent(system)}&kind=diagnose`);
  // What was seen of the model that the system has now comes before what was seen of older ones.
  const ofNow = diagnoses.data?.find(diagnosis => diagnosis.model === document.model);
  const id = query.diagnosis ?? (ofNow ?? diagnoses.data?.[0])?.id ?? null;
  const diagnosis = useResource(id && `/diagnoses/${id}`);
  const running = query.job ?? jobs.data?.find(job => !hasEnded(job))?.id ?? null;
  // What is watched tells its end by itself.
  useAfterJobs(running ? null : system, diagnoses, jobs);
  const search = () => post('/jobs', { kind: 'diagnose', system }).then(job => setQuery({ job: job.id }), sayFault);
  const found = job => {
    // The list may have shown it before its job told of its end: what somebody has added to it by then stays.
    const added = job.diagnosis === id ? {} : { steps: null, adding: null };
    setQuery({ job: null, diagnosis: job.diagnosis, ...added });
    diagnoses.reload();
    jobs.reload();
  };
  if (diagnoses.error) return html`<${Failed} error=${diagnoses.error} retry=${diagnoses.reload} />`;
  if (!diagnoses.data) return html`<${Loading} what="the diagnoses" />`;
  return html`
    ${running && html`<${JobWatch} key=${running} id=${running} title="Looking for what is missing" onEnd=${job => job.diagnosis && found(job)} />`}
    ${
      !id &&
      !running &&
      html`<${Empty} title="Nobody has looked yet">
      <p>The service adds every effect that it knows to the model ${document.model}, one after another, and keeps those that make the error on unseen data fall.</p>
      <button class="main" onClick=${search}>Find what is missing</button>
    </${Empty}>`
    }
    ${diagnosis.error && html`<${Failed} error=${diagnosis.error} retry=${diagnosis.reload} />`}
    ${id && !diagnosis.data && !diagnosis.error && html`<${Loading} what="the diagnosis" />`}
    ${diagnosis.data && html`<${Diagnosis} key=${diagnosis.data.id} data=${diagnosis.data} system=${system} document=${document}
      metrics=${metrics} query=${query} search=${running ? null : search} reload=${reload} changed=${changed} />
      <${Ledger} key=${`ledger of ${diagnosis.data.id}`} system=${system} model=${diagnosis.data.model} />`}`;
}

/** What has happened to the model since a diagnosis, as the end of a sentence. */
function changeOf(diagnosis, now) {
  const [[base, ...before], [present, ...after]] = [diagnosis.model.split('+'), now.split('+')];
  const added = after.filter(effect => !before.includes(effect));
  if (base !== present || added.length === 0 || before.some(effect => !after.includes(effect))) return `before the model became ${now}.`;
  const titled = effect => {
    const title = diagnosis.findings.find(finding => finding.effect === effect)?.title ?? effect;
    return title[0].toLowerCase() + title.slice(1);
  };
  return `before ${added.map(titled).join(' and ')} ${added.length > 1 ? 'were' : 'was'} added.`;
}

export function Diagnosis({ data, system, document, metrics, query, search, reload, changed }) {
  const path = `/diagnoses/${data.id}`;
  const [adding, setAdding] = useState(null);
  const [model, setModel] = useState(data.model);
  const isIn = (effect, grown) => grown.split('+').slice(1).includes(effect);
  const there = effect => (isIn(effect, document.model) ? 'in the model now' : isIn(effect, model) ? 'added' : null);
  const names = Object.keys(metrics);
  const several = names.length > 1;
  // What older diagnoses do not say is the first one.
  const { unit } = metrics[names[0]] ?? { unit: '' };
  const erring = data.unexplained.output || names[0];
  const weighed = data.rho !== null;
  const steps = query.steps?.split(',').filter(Boolean) ?? [];
  // What it found is added to its own model: once another one is used, only those go on who have begun.
  const isOlder = data.model !== document.model;
  return html`
    <div class="row apart">
      <p class="verdict">${
        isOlder
          ? html`<${Status} of="unknown" label="" /> This was looked at with ${data.model}, ${changeOf(data, document.model)}`
          : html`<${Status} of=${data.verdict} label="" /> ${SAYS[data.verdict]}`
      }</p>
      ${search && html`<button class=${isOlder ? 'main' : ''} onClick=${search}>Look again${isOlder ? ' with the present model' : ''}</button>`}
    </div>
    ${isOlder && html`<p>What the present model, ${document.model}, is missing is not known until somebody looks again. Then it said:</p>`}
    <p>${sentence(data.summary)}. <span
      class="quiet">Model ${data.model}, ${clock(data.created_at)}. ${
        weighed ? html`<${Term} of="noise floor">Noise floor</${Term}> ${number(data.noise_floor_rmse)} ${several ? 'times the noise of the sensors' : unit}; the error is <${Term} of="rho">${number(data.rho)} times</${Term}> what noise would leave.` : ''
      }</span></p>
    ${several && weighed && html`<p class="note">Errors are those of all outputs together, each in the noise of its sensor. What is drawn over time
      is ${erring}${erring === worstOutput(metrics) ? ', which fails most' : `; ${worstOutput(metrics)} fails most`}.</p>`}
    ${data.warnings.map(warning => html`<p class="note">▲ ${warning}</p>`)}
    <${Adding} diagnosis=${data} system=${system} document=${document} effect=${adding} steps=${steps} taken=${() => setAdding(null)}
      grown=${setModel} reload=${reload} changed=${changed} />
    ${data.findings.map(finding => html`<${Finding} key=${finding.effect} finding=${finding} data=${data} path=${path} added=${there(finding.effect)}
      output=${finding.shape?.output || names[0]} zone=${document.location?.zone ?? 'UTC'}
      add=${REPORT || (isOlder && steps.length === 0) ? null : () => setAdding({ effect: finding.effect, title: finding.title })} />`)}
    ${data.findings.length === 0 && weighed && data.verdict !== 'adequate' &&
      html`<p>No effect of the catalogue passed both gates: the gain on the data that were fitted, and the error on unseen data.</p>`}
    <${Present} effects=${data.present} />
    <${Unexplained} unexplained=${data.unexplained} path=${path} system=${system} model=${data.model}
      output=${several ? erring : null} unit=${unit} />
    ${weighed && data.verdict !== 'adequate' && data.fit && html`<${Proposals} fit=${data.fit}
      add=${isOlder && steps.length === 0 ? null : setAdding} />`}
    ${weighed && html`<${MissingHeat} path=${path} output=${several ? erring : null} system=${system} query=${query}
      zone=${document.location?.zone ?? 'UTC'} />`}
    ${(data.considered.length > 0 || data.not_testable.length > 0) && html`<div class="grid">
      <section><${Table} caption="Tested, and what became of it"
        columns=${[['effect'], ['gain in BIC', 'number'], ['of the error', 'number'], ['why']]}
        rows=${data.considered.map(entry => [
          html`<a href=${address(['effects', entry.effect.split(':')[0]])}>${entry.effect}</a>`,
          number(entry.delta_bic),
          entry.explained_share === null || entry.explained_share === undefined ? NONE : percent(entry.explained_share),
          html`<${Status} of=${entry.gate ? 'cancelled' : 'ok'} label=${entry.why} />`,
        ])} /></section>
      <section><${Table} caption="Not testable with these data: silence is not absence" columns=${[['effect'], ['reason']]}
        rows=${data.not_testable.map(entry => [html`<a href=${address(['effects', entry.effect.split(':')[0]])}>${entry.effect}</a>`,
          entry.reason])} /></section>
    </div>`}`;
}

/** What the model has already, as this window shows it; a sentence each, with its numbers behind it. */
function Present({ effects }) {
  if (!effects?.length) return null;
  return html`<section class="card" aria-labelledby="present"><h3 id="present">What the model has already</h3>
    ${effects.map(({ effect, sentence: says, pooled }) => html`<p key=${effect}>${pooled?.taken_back ? '▲ ' : ''}${says}
      ${pooled?.windows > 1 && !pooled.taken_back && html` <span class="quiet">${pooled.sentence}</span>`}</p>`)}
    <details><summary>The numbers</summary><${Table} caption="Each effect beside the model without it"
      columns=${[['effect'], ['model without it'], ['size', 'number'], ['deviation', 'number'], ['unit'], ['t', 'number'], ['of the error', 'number'], ['p of shifts', 'number'], ['windows', 'number']]}
      rows=${effects.map(({ effect, model, score, pooled }) => [
        effect, model, number(score.size), number(score.deviation), score.unit, number(score.t), percent(score.share),
        chance(score.shift_p), pooled?.windows ?? 0,
      ])} /></details></section>`;
}

const PARTS = [
  ['train', 'train'],
  ['validation', 'validation'],
  ['test', 'test (never used)'],
];

function Finding({ finding, data, path, output, zone, added, add }) {
  const pairs = [
    ...PARTS.map(([key, title]) => [title, finding.rmse[key]]),
    ...Object.entries(finding.rmse.validation_ahead ?? {}).map(([key, pair]) => [`${horizon(key)} ahead`, pair]),
  ].filter(([, pair]) => pair);
  const most = Math.max(...pairs.flatMap(([, pair]) => pair).filter(Number.isFinite));
  const titles = useTitles(`${data.model}+${finding.effect}`);
  const before = data.findings.slice(0, finding.rank - 1).map(entry => entry.title);
  return html`<article class="card finding" aria-label=${finding.title}>
    <div class="row apart"><h3>${finding.rank}. ${finding.title} <span class="quiet">${finding.kind === 'refinement' ? html`a <${Term} of="refinement">refinement</${Term}>` : ''}
      </span></h3>
      ${added ? html`<${Status} of="ok" label=${added} />` : add && html`<button class="main" onClick=${add}>Add and refit: ${finding.title}</button>`}</div>
    <p>${finding.explain} ${before.length > 0 && html`<span class="quiet">Found after ${before.join(' and ')} was in the model.</span>`}</p>
    <div class="grid">
      <div role="img" aria-label=${pairs.map(([title, [from, to]]) => `${title}: from ${number(from)} to ${number(to)}`).join('; ')}>
        ${pairs.map(
          ([title, [from, to]]) => html`<div class="pair"><span>${title}</span><span class="row">
          <${Change} from=${from} to=${to} most=${most} /><span class="number nowrap">${fixed(from)} → <b>${fixed(to)}</b></span></span></div>`,
        )}
      </div>
      <div>
        ${finding.segments && html`<p><b>Over ${number(finding.segments.hours)} h</b> it explains ${percent(finding.segments.share)} of the error: <${Term} of="t value">t</${Term}> ${
          number(finding.segments.t)}, ${number(finding.segments.beyond_clock)} <${Term} of="beyond the clock">beyond the clock</${Term}>, on ${finding.segments.days} days; <${Term} of="p value">p</${Term}> ${chance(finding.segments.p)} over all effects, ${
          chance(finding.segments.shift_p)} for its channels <${Term} of="shift p">shifted by days</${Term}>.</p>`}
        ${finding.pooled?.windows > 1 && html`<p>${finding.pooled.sentence}</p>`}
        ${finding.pooled?.taken_back && html`<p>▲ ${finding.pooled.taken_back.sentence}</p>`}
        <p>Explains ${finding.explained_share === null ?
          NONE : percent(finding.explained_share)} of the error on unseen data beyond the noise; gains ${number(finding.delta_bic)} in <${Term} of="gain in BIC">BIC</${Term}>.</p>
        ${finding.tied_with.length > 0 &&
          html`<p>▲ The data <${Term} of="tie">cannot tell it</${Term}> from ${finding.tied_with.join(', ')}. ${finding.separate_by ?
            `To tell them apart: ${finding.separate_by}.` : ''}</p>`}
        <ul>${finding.evidence.map(said => html`<li>${said}</li>`)}</ul>
        <details><summary>Its parameters</summary><${Table} caption="Parameters of this effect" hidden
          columns=${[['parameter'], ['value', 'number'], ['95 % interval', 'number'], ['unit'], ['']]}
          rows=${Object.entries(finding.parameters).map(([name, entry]) => [html`<${Parameter} symbol=${name} titles=${titles} />`, number(entry.value), entry.ci95 ?
            `${number(entry.ci95[0])} to ${number(entry.ci95[1])}` : NONE, entry.unit, entry.at_bound ?
              html`<${Status} of="bad" label="at bound" />` : ''])} /></details>
      </div>
    </div>
    <${Evidence} finding=${finding} output=${output} path=${path} zone=${zone} />
  </article>`;
}

/** Before as an outline, after as a filled bar. */
function Change({ from, to, most }) {
  const size = value => Math.max((value / most) * 150, 1);
  return html`<svg width="156" height="16" style="width:156px;flex:none" aria-hidden="true">
    <rect x="1" y="1" width=${size(from)} height="14" style="fill:none;stroke:var(--strong-edge)" /><rect x="1" y="4" width=${size(to)}
      height="8" style=${{ fill: `var(--${to < from * 0.99 ? 'model' : 'heldout'})` }} /></svg>`;
}

function Unexplained({ unexplained, path, system, model, output, unit }) {
  if (unexplained.share === null && !unexplained.ask) return null;
  const known = unexplained.profile_by_hour.some(value => value !== null);
  const rate = `${unit}/h`;
  const worst = unexplained.profile_by_hour.reduce(
    (at, value, hour, all) => (Math.abs(value ?? 0) > Math.abs(all[at] ?? 0) ? hour : at),
    0,
  );
  const says = `${percent(unexplained.share)} of the error beyond the noise has no name yet. By hour of the day it is largest at ${worst} h: ${signed(unexplained.profile_by_hour[worst], 3)} ${rate} that the model does not know.`;
  return html`<section class="card"><h3>What no effect explains: ${percent(unexplained.share)} of the error</h3>
    ${unexplained.ask && html`<p>${sentence(unexplained.ask)}</p>`}
    <div class="grid">
      ${
        known &&
        html`<${Frame} title=${`${unit === 'K' ? 'Heat that is' : 'What is'} missing, by hour of the day`} path=${path} summary=${says}
        table=${() => ({
          columns: [
            ['hour', 'number'],
            [rate, 'number'],
          ],
          rows: unexplained.profile_by_hour.map((value, hour) => [hour, number(value)]),
        })}>
        <${Bars} values=${unexplained.profile_by_hour} signedColours xLabel="hour of the day" yLabel=${rate} label=${says} /></${Frame}>`
      }
      <${Table} caption=${output ? `When ${output} is worst` : 'When it is worst'} columns=${[['from'], ['bias', 'number'], ['rmse', 'number'], ['']]}
        rows=${unexplained.episodes.map(episode => [
          clock(episode.from),
          `${signed(episode.bias)} ${unit}`,
          `${fixed(episode.rmse)} ${unit}`,
          html`<a href=${systemAddress(system, 'fit', { from: episode.from, to: episode.to, output })}>Show</a>`,
        ])} />
    </div>
    ${!REPORT && html`<p><a class="button" href=${address(['edit', 'effect'], { system, model })}>Describe your own effect</a></p>`}
  </section>`;
}
