// One job: as it goes, what was asked, and where it leads.
import { html, useState } from '../html.js';
import { useResource, post, curl } from '../api.js';
import { address, systemAddress, go } from '../router.js';
import { sayFault } from '../say.js';
import { clock, number } from '../format.js';
import { Status } from '../parts/status.js';
import { Failed, Loading } from '../parts/screens.js';
import { JobWatch } from '../parts/watch.js';
import { Command } from '../parts/frame.js';
import { Table } from '../parts/table.js';
import { Term } from '../parts/term.js';

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
      <span class="row">${now.outcome && html`<${Status} of=${now.outcome} help />`}<button onClick=${again}>Run it again</button></span></div>
    <p class="quiet">${now.model}; ${now.origin}${now.experiment &&
      html`, an <${Term} of="experiment">experiment</${Term}> that never changes what is served`}; asked for ${clock(now.created_at)}.</p>
    ${
      now.fit &&
      html`<p class="row"><a class="button"
        href=${systemAddress(now.system, tab, { fit: tab === 'fit' ? now.fit : null, diagnosis: now.diagnosis })}>See what it found</a>
      <a class="button" href=${systemAddress(now.system, 'parameters', { fit: now.fit })}>Its parameters and checks</a></p>`
    }
    ${now.tuning && html`<${Tuning} of=${now.tuning} outcome=${now.outcome} />`}
    <${JobWatch} id=${id} onEnd=${setEnded} />
    <details class="card"><summary>What was asked, with every default</summary><pre>${JSON.stringify(now.request, null, 2)}</pre>
      <${Command} text=${curl('/jobs', { method: 'POST', body: { kind: now.kind, system: now.system, model: now.model } })} /></details>`;
}

const TAKEN = {
  accepted: 'The jobs of the system search with them from now on.',
  suggested: 'Nothing has changed: write them into the document of the system to take them.',
};

/** What a tuning came to: the sentence, both sides on the windows that the choice did not see, and what is different. */
function Tuning({ of: { summary, judged, changes }, outcome }) {
  const percent = share => `${number(100 * share, 3)} %`;
  const side = (title, { within, to_reach, evaluations }) => [title, percent(within), number(to_reach), number(evaluations)];
  return html`<section class="card" aria-label="Tuning">
    <p>${summary} ${TAKEN[outcome]}</p>
    ${
      judged &&
      html`<${Table} caption="On windows that the choice did not see"
        columns=${[['settings'], ['within 1 % of the best', 'number'], ['evaluations until then', 'number'], ['evaluations in all', 'number']]}
        rows=${[side('in use before', judged.before), side('tuned', judged.tuned)]} />`
    }
    ${
      Object.keys(changes).length > 0 &&
      html`<${Table} caption="What is different" columns=${[['setting'], ['before', 'number'], ['tuned', 'number']]}
        rows=${Object.entries(changes).map(([name, [before, tuned]]) => [name, String(before), String(tuned)])} />`
    }
  </section>`;
}
