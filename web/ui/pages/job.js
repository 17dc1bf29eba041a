// One job: as it goes, what was asked, and where it leads.
import { html, useState } from '../html.js';
import { useResource, post, curl } from '../api.js';
import { address, systemAddress, go } from '../router.js';
import { sayFault } from '../say.js';
import { clock } from '../format.js';
import { Status } from '../parts/status.js';
import { Failed, Loading } from '../parts/screens.js';
import { JobWatch } from '../parts/watch.js';
import { Command } from '../parts/frame.js';

const TABS = { diagnose: 'missing', ladder: 'ladder' };

export function JobPage({ id }) {
  const job = useResource(`/jobs/${id}`);
  const [ended, setEnded] = useState(null);
  if (job.error) return html`<${Failed} error=${job.error} retry=${job.reload} />`;
  if (!job.data) return html`<${Loading} what="the job" />`;
  const now = ended ?? job.data;
  const again = () => post(`/jobs/${id}/retry`).then(next => go(address(['jobs', next.id])), sayFault);
  const tab = TABS[now.kind] ?? 'fit';
  return html`
    <div class="row apart"><h1>${now.kind} of <a href=${systemAddress(now.system)}>${now.system}</a></h1>
      <span class="row">${now.outcome && html`<${Status} of=${now.outcome} />`}<button onClick=${again}>Run it again</button></span></div>
    <p class="quiet">${now.model}; ${now.origin}${now.experiment ?
      ', an experiment that never changes what is served' : ''}; asked for ${clock(now.created_at)}.</p>
    ${
      now.fit &&
      html`<p class="row"><a class="button"
        href=${systemAddress(now.system, tab, { fit: tab === 'fit' ? now.fit : null, diagnosis: now.diagnosis })}>See what it found</a>
      <a class="button" href=${systemAddress(now.system, 'parameters', { fit: now.fit })}>Its parameters and checks</a></p>`
    }
    <${JobWatch} id=${id} onEnd=${setEnded} />
    <details class="card"><summary>What was asked, with every default</summary><pre>${JSON.stringify(now.request, null, 2)}</pre>
      <${Command} text=${curl('/jobs', { method: 'POST', body: { kind: now.kind, system: now.system, model: now.model } })} /></details>`;
}
