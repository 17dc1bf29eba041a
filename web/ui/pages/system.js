// One system: what is served, which fit is looked at, and the tabs.
import { html, useRef } from '../html.js';
import { useResource, useList, post, AGAIN } from '../api.js';
import { systemAddress, setQuery, go, address } from '../router.js';
import { useAfterJobs, useEvents } from '../events.js';
import { useSystems, needsSomebody, refresh } from '../systems.js';
import { useKeys } from '../keys.js';
import { say, sayFault } from '../say.js';
import { fitName, plainly } from '../format.js';
import { Figures } from '../parts/figures.js';
import { nextOutput } from '../parts/outputs.js';
import { Status, Flags } from '../parts/status.js';
import { Failed, Loading } from '../parts/screens.js';
import { Waiting, waitingOf } from './waiting.js';
import { Front } from './front.js';
import { FitTab } from './fit.js';
import { Fails } from './fails.js';
import { Missing } from './missing.js';
import { LadderTab } from './ladder.js';
import { Parameters } from './parameters.js';
import { Data } from './data.js';
import { Settings } from './settings.js';

const TABS = [
  ['fit', 'Fit', FitTab],
  ['fails', 'Where it fails', Fails],
  ['missing', 'What is missing', Missing],
  ['ladder', 'Ladder', LadderTab],
  ['parameters', 'Parameters', Parameters],
  ['data', 'Data', Data],
  ['settings', 'Settings', Settings],
];
/** What of the address goes along from tab to tab: the fits that are looked at, the range and the output. */
const CARRIED = ['fit', 'with', 'from', 'to', 'mode', 'output'];
/** Where all outputs can be seen at once. */
const ALL_OUTPUTS = ['fit'];

/** Whose the pictures of a page are: the system, its model and its fit. */
const aboutOf = (system, fit, params) =>
  [system, fit && `fit of ${fitName(fit)}`, fit && params?.fit === fit.id && `revision ${params.revision}`].filter(Boolean).join(' · ');

export function SystemPage({ system, tab, query }) {
  const document = useResource(`/systems/${system}`);
  // A site has no model, and nothing is served; of a model that was never validated the nominal values come.
  const model = document.data?.model;
  const served = useResource(model ? `/params/${system}?accept=nominal` : null);
  const { rows } = useSystems();
  const fits = useList(`/fits?system=${encodeURIComponent(system)}`);
  const carried = Object.fromEntries(CARRIED.map(name => [name, query[name]]));
  useEvents((kind, data) => kind === 'finished' && data.system === system && say(`${data.kind} of ${system}: ${data.outcome ?? data.state}`));
  useAfterJobs(system, served, fits);
  const names = rows?.map(row => row.system) ?? [];
  const step = by => {
    const next = names[(names.indexOf(system) + by + names.length) % names.length];
    if (next) go(systemAddress(next, tab));
  };
  const refit = () => post('/jobs', { kind: 'estimate', system }).then(job => go(address(['jobs', job.id])), sayFault);
  /** A change of the document was answered. */
  const changed = answer => {
    document.replace(answer);
    refresh(system);
  };
  const usable = (fits.data ?? []).filter(fit => fit.metrics && Object.keys(fit.metrics).length);
  const params = served.data?.revision ? served.data : null;
  const fit = query.fit ?? params?.fit ?? usable[0]?.id ?? null;
  const chosen = usable.find(entry => entry.id === fit);
  const metrics = chosen?.metrics ?? {};
  useKeys({
    ...Object.fromEntries(
      TABS.map(([name, title], index) => [String(index + 1), [`show ${title}`, () => go(systemAddress(system, name, carried))]]),
    ),
    '[': ['system before', () => step(-1)],
    ']': ['next system', () => step(1)],
    r: ['refit', refit],
    ...(Object.keys(metrics).length > 1 && { o: ['next output', () => nextOutput(query, metrics, ALL_OUTPUTS.includes(tab))] }),
    z: ['show the whole range', () => setQuery({ from: null, to: null })],
  });
  if (document.error) return html`<${Failed} error=${document.error} retry=${document.reload} />`;
  if (!document.data || (model && !served.data) || !fits.data) {
    const error = served.error ?? fits.error;
    return error
      ? html`<${Failed} error=${error} retry=${() => {
          served.reload();
          fits.reload();
        }} />`
      : html`<${Loading} what=${system} />`;
  }
  const row = rows?.find(entry => entry.system === system);
  const waiting = waitingOf(fits.data, model);
  const reload = () => {
    [document, served, fits].forEach(resource => resource.reload());
    refresh(system);
  };
  const Tab = (TABS.find(([name]) => name === tab) ?? TABS[0])[2];
  return html`
    <${Head} system=${system} document=${document.data} params=${params} row=${row} fits=${usable}
      chosen=${chosen} query=${query} refit=${refit} />
    ${waiting && html`<${Waiting} key=${waiting.id} system=${system} fit=${waiting} served=${params} done=${() => dispatchEvent(new Event(AGAIN))} />`}
    <${Tabs} system=${system} tab=${tab} carried=${carried} />
    <div role="tabpanel" id="panel" aria-labelledby=${`tab-${tab}`} data-about=${aboutOf(system, chosen, params)}>
      ${Tab === FitTab && fit && html`<${Front} system=${system} fit=${params?.fit ?? fit} params=${params} document=${document.data}
        metrics=${usable.find(entry => entry.id === (params?.fit ?? fit))?.metrics ?? {}} query=${query} />`}
      <${Tab} key=${tab} system=${system} document=${document.data} params=${params} fits=${usable} fit=${fit}
        metrics=${metrics} query=${query} reload=${reload} changed=${changed} />
    </div>`;
}

function Head({ system, document, params, row, fits, chosen, query, refit }) {
  const diagnose = () =>
    post('/jobs', { kind: 'diagnose', system }).then(job => go(systemAddress(system, 'missing', { job: job.id })), sayFault);
  return html`
    <div class="row apart">
      <div class="row"><h1>${system}</h1><span class="quiet">${document.label}</span>
        <${Status} of=${params?.status ?? 'none'} label=${params ? `${params.status}, revision ${params.revision}` : 'nothing served'} help />
        <${Flags} of=${params?.flags ?? []} model=${params?.model} brief /></div>
      <span class="row"><button onClick=${diagnose}>Find what is missing</button><button class="main" onClick=${refit}>Refit</button></span>
    </div>
    ${row && html`<p><${Status} of=${row.health} label="" /> ${plainly(row.why)}${
      needsSomebody(row) && html` <a href=${row.next.href}>${row.next.text}</a>`
    }</p>`}
    <div class="row apart">
      ${chosen ? html`<${Figures} fit=${chosen} query=${query} />` : ''}
      ${
        fits.length > 0 &&
        html`<label class="inline">Fit <select value=${chosen?.id} onChange=${event => setQuery({ fit: event.target.value })}>
        ${fits.map(entry => html`<option value=${entry.id} selected=${entry === chosen}>${fitName(entry)}</option>`)}</select></label>`
      }
    </div>`;
}

function Tabs({ system, tab, carried }) {
  const list = useRef(null);
  const onKeyDown = event => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const links = [...list.current.querySelectorAll('a')];
    const next = links[(links.indexOf(event.target) + step + links.length) % links.length];
    next.focus();
    next.click();
  };
  return html`<div class="tabs" role="tablist" aria-label="What to see of it" ref=${list} onKeyDown=${onKeyDown}>
    ${TABS.map(
      ([
        name,
        title,
      ]) => html`<a role="tab" id=${`tab-${name}`} href=${systemAddress(system, name, carried)} aria-selected=${name === tab} aria-controls="panel"
      tabindex=${name === tab ? 0 : -1}>${title}</a>`,
    )}
  </div>`;
}
