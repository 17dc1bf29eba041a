// Writing a model or an effect: every fault at its line while one types, and what the model then does.
import { html, useState, useEffect, useRef, useMemo } from '../html.js';
import { ask, post, useList } from '../api.js';
import { address, go, systemAddress } from '../router.js';
import { parse, lineOf } from '../json-lines.js';
import { say } from '../say.js';
import { Failed } from '../parts/screens.js';
import { Preview } from '../parts/preview.js';
import { Status } from '../parts/status.js';

const SETTLE_MS = 300;

const MODEL = {
  id: 'my_room',
  title: 'Room without envelope (one state)',
  states: { T_r: { unit: 'degC', initial: 'T_room' } },
  inputs: { T_out: { unit: 'degC' } },
  parameters: { alpha: { unit: '1/h', lower: 0.001, upper: 15, scale: 'log', nominal: 0.1, title: 'room to outdoors' } },
  equations: { T_r: 'alpha*(T_out - T_r)' },
  outputs: { T_room: { expr: 'T_r', unit: 'degC', noise_sd: 0.05 } },
};
const EFFECT = {
  id: 'my_effect',
  title: 'Aquarium',
  explain: 'A heated aquarium warms the room.',
  signature: 'A steady gain that no thermostat explains.',
  measure: "the power of the aquarium's heater",
  sign: 'positive',
  parameters: { c_aquarium: { unit: 'K/h', lower: 0, upper: 1, scale: 'linear', nominal: 0.1, title: 'gain of the aquarium' } },
  terms: { T_r: 'c_aquarium' },
};

export function Editor({ kind, query }) {
  const isModel = kind === 'model';
  const models = useList(isModel ? null : '/models');
  const [text, setText] = useState(() => JSON.stringify(isModel ? MODEL : EFFECT, null, 2));
  const [faults, setFaults] = useState([]);
  const [base, setBase] = useState(query.model ?? 'room2');
  const [error, setError] = useState(null);
  const [checked, setChecked] = useState(false);
  useEffect(() => {
    if (!query.from) return;
    ask(`/${isModel ? 'models' : 'effects'}/${encodeURIComponent(query.from)}`).then(found => {
      const document = isModel ? found.document : found;
      const { id, ...rest } = document;
      setText(JSON.stringify({ id: `my_${id}`, ...rest }, null, 2));
    }, setError);
  }, []);
  const read = useMemo(() => {
    try {
      return { ...parse(text), fault: null };
    } catch (fault) {
      return { value: null, lines: new Map(), fault };
    }
  }, [text]);
  useEffect(() => {
    setChecked(false);
    if (read.fault) {
      setFaults([{ line: read.fault.line, detail: read.fault.message }]);
      return undefined;
    }
    if (!isModel) return undefined;
    const timer = setTimeout(
      () =>
        post('/models/validate', read.value).then(answer => {
          setFaults(placed(answer.errors ?? [], read.lines));
          setChecked(true);
        }, setError),
      SETTLE_MS,
    );
    return () => clearTimeout(timer);
  }, [text]);
  // An effect is judged in the model that it is added to: the preview names its faults.
  const previewFaults = errors => {
    if (isModel || read.fault) return;
    setFaults(
      placed(
        errors.map(fault => ({ ...fault, pointer: fault.pointer.replace(/^\/effects\/0/, '') })),
        read.lines,
      ),
    );
    setChecked(true);
  };
  const save = async () => {
    setError(null);
    try {
      if (isModel) {
        const made = await post('/models', read.value);
        say(`${made.id} is taken`);
        go(address(['models', made.id]));
      } else {
        const made = await post(`/models/${encodeURIComponent(base)}/effects`, read.value);
        say(`${made.id} is taken`);
        if (query.system) {
          const job = await post('/jobs', { kind: 'estimate', system: query.system, model: made.id, experiment: true });
          go(address(['jobs', job.id]));
        } else go(address(['models', made.id]));
      }
    } catch (fault) {
      setError(fault);
      if (fault.errors) setFaults(placed(fault.errors, read.lines));
    }
  };
  const good = faults.length === 0 && !read.fault;
  const onKeyDown = event => {
    if ((event.ctrlKey || event.metaKey) && event.key === 's') {
      event.preventDefault();
      if (good) save();
    }
  };
  return html`<div onKeyDown=${onKeyDown}>
    <div class="row apart"><h1>${isModel ? 'Write a model' : 'Describe an effect'}</h1>
      <span class="row">${
        !isModel &&
        html`<label class="inline">added to <select value=${base} onChange=${event => setBase(event.target.value)}>
          ${[...new Set([base, ...(models.data ?? []).map(model => model.id)])].map(id =>
            html`<option value=${id} selected=${id === base}>${id}</option>`)}</select></label>`
      }
        <button class="main" disabled=${!good} onClick=${save}>
          ${isModel ? 'Save as a new model' : query.system ? 'Add and refit' : 'Save and add'} (Ctrl S)</button></span></div>
    ${query.system && html`<p>It is then fitted to <a href=${systemAddress(query.system, 'missing')}>${query.system}
      </a>, as an experiment that never changes what is served.</p>`}
    <div class="grid">
      <section>
        <${Lines} text=${text} setText=${setText} faults=${faults} />
        <div role="status">${
          good
            ? html`<p><${Status} of=${checked ? 'ok' : 'queued'}
              label=${checked ? 'No faults: names, equations and units agree.' : 'Checking …'} /></p>`
            : html`<p><${Status} of="bad" label=${`${faults.length} ${faults.length === 1 ? 'fault' : 'faults'}`} /></p>
            <ul class="faults">${faults.map(fault =>
              html`<li><b>line ${fault.line}
                </b> ${fault.pointer ? html`<code>${fault.pointer}</code> ` : ''}${fault.detail}${fault.suggestion ?
                  html` <em>${fault.suggestion}</em>` : ''}</li>`)}</ul>`
        }</div>
        ${error && html`<${Failed} error=${error} />`}
        <p class="note">Units are words such as degC, K/h, 1/h, kW, W/m2; every equation is checked for them. Functions: min max abs exp log sqrt sin cos tanh if delay.</p>
      </section>
      <section>${read.value && html`<${Preview} request=${isModel ? { model: read.value } : { model: base, effects: [read.value] }}
        system=${query.system} faulty=${previewFaults} />`}</section>
    </div></div>`;
}

/** Faults with the line of their pointer, in the order of the lines. */
const placed = (errors, lines) => errors.map(fault => ({ ...fault, line: lineOf(lines, fault.pointer) })).sort((a, b) => a.line - b.line);

/** A field with line numbers; a line with a fault has a mark. Tab leaves the field, as everywhere. */
function Lines({ text, setText, faults }) {
  const gutter = useRef(null);
  const marked = new Set(faults.map(fault => fault.line));
  return html`<div class="editor">
    <pre ref=${gutter} aria-hidden="true">
      ${text.split('\n').map((_, at) => html`<span class=${marked.has(at + 1) ? 'fault' : ''}>${marked.has(at + 1) ? '■ ' : ''}${at + 1}
        </span>`)}</pre>
    <textarea spellcheck="false" aria-label="Document, JSON" aria-invalid=${faults.length > 0} value=${text}
      onInput=${event => setText(event.target.value)}
      onScroll=${event => {
        gutter.current.scrollTop = event.target.scrollTop;
      }}></textarea>
  </div>`;
}
