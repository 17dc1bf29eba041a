// Writing a model or an effect: every fault at its line while one types, and what the model then does.
import { html, useState, useEffect, useRef, useMemo } from '../html.js';
import { ask, every, post, useList, useResource } from '../api.js';
import { address, go, systemAddress } from '../router.js';
import { parse, lineOf } from '../json-lines.js';
import { say } from '../say.js';
import { Failed, Shown } from '../parts/screens.js';
import { Compared } from '../parts/compared.js';
import { Preview } from '../parts/preview.js';
import { Status } from '../parts/status.js';

const SETTLE_MS = 300;
/** The model that an effect is added to where no system has one. */
const SMALL = 'room2';

const MODEL = {
  id: 'my_room',
  title: 'Room without envelope (one state)',
  states: { T_r: { unit: 'degC', initial: 'T_room' } },
  inputs: { T_out: { unit: 'degC' } },
  parameters: { alpha: { unit: '1/h', lower: 0.001, upper: 15, scale: 'log', nominal: 0.1, title: 'room to outdoors' } },
  equations: { T_r: 'alpha*(T_out - T_r)' },
  outputs: { T_room: { expr: 'T_r', unit: 'degC', noise_sd: 0.05 } },
};
/** An effect to begin with: a steady gain of the first state of a model. */
const steadyGain = ({ states: [{ name, unit }] }) => ({
  id: 'my_effect',
  title: 'Steady gain',
  explain: `Something that is always on adds to ${name}.`,
  signature: 'The model is too low by the same at all hours.',
  measure: 'the power of what is always on',
  sign: 'positive',
  parameters: { c_steady: { unit: rateOf(unit), lower: 0, upper: 1, scale: 'linear', nominal: 0.1, title: 'the steady gain' } },
  terms: { [name]: 'c_steady' },
});
const rateOf = unit => (unit === 'degC' ? 'K/h' : unit === '-' ? '1/h' : `${unit}/h`);

/** What saving is called: without a system, and with one. */
const SAVE = { model: ['Save as a new model', 'Save and refit'], effect: ['Save and add', 'Add and refit'] };

const textOf = document => JSON.stringify(document, null, 2);
const modelAt = id => ask(`/models/${encodeURIComponent(id)}`);
/** An id that is free to be written: names of models have marks that stand for their effects. */
const ownId = id => `my_${id.replaceAll(/\W+/g, '_')}`.slice(0, 60);

/** The document of a model as one that is written anew. One with effects names its base and them. */
function derived({ id, title, effects, document }) {
  const whole = document.base ?? document.id;
  const { id: _, ...rest } = effects.length > 0 ? { title, base: whole, effects } : document;
  return { id: ownId(id), ...rest };
}

/** The models of a system, or of all, those of rooms first. */
async function modelsOf(system) {
  const rows = system ? [await ask(`/systems/${system}`)] : await every('/systems');
  const isRoom = row => row.system.startsWith('room/');
  return [...new Set(rows.toSorted((one, other) => isRoom(other) - isRoom(one)).flatMap(row => row.model ?? []))];
}

/** The first of these models that has the states which the terms of an effect are of. */
async function firstWith(terms, models) {
  for (const id of models) {
    const { states } = await modelAt(id);
    if (Object.keys(terms).every(place => states.some(({ name }) => name === place))) return id;
  }
  return models[0];
}

/** What the editor begins with: `{text, base}`; the base is the model that a draft was made from or an effect is added to. */
async function begin(isModel, { from, model, system }) {
  if (isModel) {
    const base = from ?? (system ? (await modelsOf(system))[0] : null) ?? null;
    return base === null ? { text: textOf(MODEL), base } : { text: textOf(derived(await modelAt(base))), base };
  }
  const models = model ? [model] : [...(await modelsOf(system)), SMALL];
  if (!from) return { text: textOf(steadyGain(await modelAt(models[0]))), base: models[0] };
  const { id, ...rest } = await ask(`/effects/${encodeURIComponent(from)}`);
  return { text: textOf({ id: ownId(id), ...rest }), base: await firstWith(rest.terms ?? {}, models) };
}

export function Editor({ kind, query }) {
  const first = useResource(kind, { read: () => begin(kind === 'model', query) });
  // What has been written stays, whatever is answered when this is asked again after a break.
  const begun = useRef(null);
  begun.current ??= first.data;
  return html`<${Shown} of=${begun.current ? { data: begun.current } : first} what="the document to begin with" show=${found =>
    html`<${Writing} kind=${kind} query=${query} first=${found} />`} />`;
}

function Writing({ kind, query, first }) {
  const isModel = kind === 'model';
  const models = useList('/models');
  const [text, setText] = useState(first.text);
  const [faults, setFaults] = useState([]);
  const [base, setBase] = useState(first.base);
  const [error, setError] = useState(null);
  const [checked, setChecked] = useState(false);
  // What was not touched follows the model that it is added to.
  const example = useRef(query.from ? null : first.text);
  const take = async id => {
    setBase(id);
    if (isModel || text !== example.current) return;
    try {
      example.current = textOf(steadyGain(await modelAt(id)));
      setText(example.current);
    } catch (fault) {
      setError(fault);
    }
  };
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
    let left = false;
    const validate = async () => {
      try {
        const { errors = [] } = await post('/models/validate', read.value);
        // It may be of an older text by now.
        if (left) return;
        setFaults(placed(errors, read.lines));
        setChecked(true);
      } catch (fault) {
        if (!left) setError(fault);
      }
    };
    const timer = setTimeout(validate, SETTLE_MS);
    return () => {
      left = true;
      clearTimeout(timer);
    };
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
      const made = await post(isModel ? '/models' : `/models/${encodeURIComponent(base)}/effects`, read.value);
      say(`${made.id} is taken`);
      if (query.system) {
        const job = await post('/jobs', { kind: 'estimate', system: query.system, model: made.id, experiment: true });
        go(address(['jobs', job.id]));
      } else go(address(['models', made.id]));
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
      <span class="row"><label class="inline">${isModel ? 'compared with' : 'added to'} <select value=${base ?? ''}
          onChange=${event => take(event.target.value || null)}>
          ${isModel && html`<option value="" selected=${base === null}>no other model</option>`}
          ${[...new Set([...(base === null ? [] : [base]), ...(models.data ?? []).map(model => model.id)])].map(id =>
            html`<option value=${id} selected=${id === base}>${id}</option>`)}</select></label>
        <button class="main" disabled=${!good} onClick=${save}>
          ${SAVE[kind][query.system ? 1 : 0]} (Ctrl S)</button></span></div>
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
                </b> ${fault.pointer ? html`<code>${fault.pointer}</code> ` : ''}${inLine(fault.detail)}${fault.suggestion ?
                  html` <em>${fault.suggestion}</em>` : ''}</li>`)}</ul>`
        }</div>
        ${error && html`<${Failed} error=${error} />`}
        <p class="note">Units are words such as degC, K/h, 1/h, kW, W/m2; every equation is checked for them. Functions: min max abs exp log sqrt sin cos tanh if delay.</p>
      </section>
      <section>${isModel && base !== null && read.value && html`<${Compared} key=${base} with=${base} written=${read.value} />`}
        ${read.value && html`<${Preview} request=${isModel ? { model: read.value } : { model: base, effects: [read.value] }}
        system=${query.system} faulty=${previewFaults} />`}</section>
    </div></div>`;
}

/** An equation is one line of the document: within it only the column says more. */
const inLine = detail => detail.replace(/^line 1, (column \d+: )/, '$1');

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
