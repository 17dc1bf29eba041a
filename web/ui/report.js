// A report of the command line: the page's own charts and tables, below each other, without a service.
import { html, render, useEffect, useRef } from './html.js';
import { REPORT } from './carried.js';
import { useResource } from './api.js';
import { useHere, setQuery, address } from './router.js';
import { useKeys } from './keys.js';
import { clock } from './format.js';
import { Shell } from './parts/shell.js';
import { Command } from './parts/frame.js';
import { Figures } from './parts/figures.js';
import { Shown } from './parts/screens.js';
import { FitTab } from './pages/fit.js';
import { Fails } from './pages/fails.js';
import { Diagnosis } from './pages/missing.js';
import { Ladder } from './pages/ladder.js';
import { Values, Judgement } from './pages/parameters.js';
import { Likelihood } from './pages/likelihood.js';
import { EffectPage } from './pages/model.js';

const { kind, id, zone, made_at: madeAt, version } = REPORT;
const TITLES = { fit: 'Fit', diagnose: 'What is missing', ladder: 'Error ladder' };
/** What the pages read of a system. */
const { metrics } = REPORT.answers[`/fits/${id}`];
const SYSTEM = { model: REPORT.answers[`/fits/${id}`].model, location: { zone: zone ?? 'UTC' } };
const quoted = word => (/^[\w./:=,+-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`);

function App() {
  const { parts, query } = useHere();
  const fit = useResource(`/fits/${id}`);
  const diagnosis = useResource(kind === 'diagnose' ? `/diagnoses/${id}` : null);
  const ladder = useResource(kind === 'ladder' ? `/systems/${id}/ladder` : null);
  const chart = useRef(null);
  useKeys({ z: ['show the whole range', () => setQuery({ from: null, to: null })] });
  // An hour or an episode that is chosen further down is shown above.
  useEffect(() => {
    if (query.from) chart.current?.scrollIntoView({ block: 'nearest' });
  }, [query.from, query.to]);
  if (parts[0] === 'effects') return html`<${Shell}><p><a href=${address([])}>Back to the report</a></p><${EffectPage} id=${parts[1]} /></${Shell}>`;
  const { model } = SYSTEM;
  return html`<${Shell}>
    <h1>${TITLES[kind]}: ${model}</h1>
    <p class="quiet">Made ${clock(madeAt)} UTC by Lampyris ${version} with</p>
    <${Command} text=${['lampyris', ...REPORT.command.map(quoted)].join(' ')} />
    ${kind === 'diagnose' &&
      html`<${Shown} of=${diagnosis} what="the diagnosis" show=${data => html`<${Diagnosis} data=${data} system=${id} document=${SYSTEM} metrics=${metrics} query=${query} />`} />`}
    ${kind === 'ladder' && html`<${Shown} of=${ladder} what="the ladder" show=${data => html`<${Ladder} data=${data} path=${`/systems/${id}/ladder`} />`} />`}
    ${kind !== 'fit' && html`<h2>The fit of ${model} that this starts from</h2>`}
    <${Shown} of=${fit} what="the fit" show=${data => html`<${Figures} fit=${data} query=${query} />`} />
    <section ref=${chart} aria-label="Measured and model">
      <${FitTab} system=${id} fit=${id} fits=${[]} metrics=${metrics} params=${null} document=${SYSTEM} query=${query} /></section>
    <h2>Where it fails</h2>
    <${Fails} system=${id} fit=${id} metrics=${metrics} query=${query} document=${SYSTEM} />
    <h2>Parameters</h2>
    <${Shown} of=${fit} what="the fit" show=${data => html`<${Values} fit=${data} history=${[]} /><${Likelihood} fit=${data} /><${Judgement} fit=${data} />`} />
  </${Shell}>`;
}

document.title = `${TITLES[kind]}: ${SYSTEM.model} · Lampyris`;
render(html`<${App} />`, document.getElementById('page'));
