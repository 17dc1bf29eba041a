// Gives a model to the controller: it becomes that of the system and is fitted to the newest data, and the gate decides.
import { html, useState } from '../html.js';
import { post, putSystem } from '../api.js';
import { systemAddress } from '../router.js';
import { say } from '../say.js';
import { NotSaved } from './screens.js';
import { JobWatch } from './watch.js';

/**
 * `use(model, make)` has the system take the model; `make` makes sure that it is there. `told` are what it came to, to be
 * shown near the button; `reload` reads the system anew where somebody else was first, `changed` takes its new document.
 */
export function useAdoption({ system, document, reload, changed }) {
  const [fitting, setFitting] = useState(null);
  const [refused, setRefused] = useState(null);
  const forget = () => {
    setFitting(null);
    setRefused(null);
  };
  const use = async (model, make = () => {}) => {
    setRefused(null);
    try {
      await make();
      changed(await putSystem(document, { ...document, model }));
      const started = await post('/jobs', { kind: 'estimate', system });
      setFitting({ job: started.id, model });
      say(`${model} is now the model of ${system}; it is fitted to the newest data`);
    } catch (fault) {
      setRefused({ fault, model });
    }
  };
  const again = () => {
    setRefused(null);
    reload();
  };
  const told = html`
    ${refused && html`<${NotSaved} error=${refused.fault} again=${again}><p>Somebody has changed ${system} since this page was opened. Look at its
      settings, and press the button again if ${refused.model} is still right.</p></${NotSaved}>`}
    ${
      fitting &&
      html`<${JobWatch} key=${fitting.job} id=${fitting.job} title=${`Fit of ${fitting.model} for the controller`}
        onEnd=${done => say(`The gate says: ${done.outcome ?? done.state}`)} />
      <p><a href=${systemAddress(system, 'parameters')}>See what is served, and why</a></p>`
    }`;
  return { use, told, forget };
}
