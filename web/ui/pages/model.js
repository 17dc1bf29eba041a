// One model, one effect: equations, parameters with their units, and how it came about.
import { html } from '../html.js';
import { useResource } from '../api.js';
import { REPORT } from '../carried.js';
import { address } from '../router.js';
import { number } from '../format.js';
import { titleOf } from '../parts/names.js';
import { Table } from '../parts/table.js';
import { Shown } from '../parts/screens.js';
import { Equations, Typeset } from '../parts/equations.js';
import { Preview } from '../parts/preview.js';

export function ModelPage({ id }) {
  const model = useResource(`/models/${encodeURIComponent(id)}`);
  return html`<${Shown} of=${model} what="the model" show=${data => html`
    <div class="row apart"><h1>${data.id}</h1><span class="row"><a class="button"
      href=${address(['edit', 'model'], { from: data.id })}>Write a new one from it</a><a class="button"
        href=${address(['edit', 'effect'], { model: data.id })}>Describe an effect for it</a></span></div>
    <p>${data.title}${data.document.description ? `. ${data.document.description}` : ''}</p>
    ${data.parent && html`<p>Made from <a href=${address(['models', data.parent])}>${data.parent}
      </a> by adding ${data.diff?.title ?? data.diff?.effect}.</p>`}
    ${data.parent && data.diff ? html`<${Equations} model=${data.parent} diff=${data.diff} />` : html`<${Equations} model=${data.id} />`}
    <${Typeset} path=${`/models/${encodeURIComponent(data.id)}/equations`} states=${data.states.length} />
    <${Table} caption="Parameters" columns=${[['name'], ['what it is'], ['unit'], ['lower', 'number'], ['upper', 'number'], ['nominal',
      'number'], ['scale']]}
      rows=${data.parameters.map(entry => [entry.name, entry.title, entry.unit, number(entry.bounds[0]), number(entry.bounds[1]),
        typeof entry.nominal === 'number' ? number(entry.nominal) : entry.nominal, entry.scale])} />
    <div class="grid">
      <section><${Table} caption="Inputs" columns=${[['name'], ['channel'], ['unit'], ['between samples']]}
        rows=${data.inputs.map(entry => [entry.name, entry.channel, entry.unit, entry.hold === 'zero_order' ? 'held' : 'straight line'])} /></section>
      <section><${Table} caption="States and outputs" columns=${[['name'], ['unit'], ['']]}
        rows=${[...data.states.map(entry => [entry.name, entry.unit, 'state']), ...data.outputs.map(entry => [entry.channel, entry.unit,
          `output, noise ${entry.noise_sd}`])]} /></section>
    </div>
    <${Preview} request=${{ model: data.id }} />`} />`;
}

/** A family stands for one effect per channel or choice: its mark is shown as a word. */
export const general = text => text.replaceAll(/\{(\w+)\}/g, '‹$1›');

export function EffectPage({ id }) {
  const effect = useResource(`/effects/${encodeURIComponent(id)}`);
  return html`<${Shown} of=${effect} what="the effect" show=${data => html`
    <div class="row apart"><h1>${general(data.title)} <span class="quiet">${data.id}</span></h1>${!REPORT &&
      html`<a class="button" href=${address(['edit', 'effect'], { from: data.id })}>Write a new one from it</a>`}</div>
    <p>${general(data.explain)}</p>
    <p><b>Without it:</b> ${general(data.signature)}</p>
    ${data.measure && html`<p><b>To be sure, measure</b> ${general(data.measure)}.</p>`}
    <div class="equation">${[...Object.entries(data.terms ?? {}).map(([state, term]) => [`d${state}/dt`, term]),
      ...Object.entries(data.outputs ?? {})].map(([place, term]) => html`<div>${place} = …<ins>+ ${term}</ins></div>`)}</div>
    <${Table} caption="Parameters" columns=${[['name'], ['what it is'], ['unit'], ['lower', 'number'], ['upper', 'number'], ['nominal',
      'number'], ['scale']]}
      rows=${Object.entries(data.parameters ?? {}).map(([name, entry]) => [name, general(titleOf(entry)), entry.unit, number(entry.lower),
        number(entry.upper), number(entry.nominal), entry.scale])} />
    ${
      Object.keys(data.inputs ?? {}).length > 0 &&
      html`<p>Needs ${Object.entries(data.inputs)
        .map(([name, entry]) => `${name} (${entry.unit})`)
        .join(', ')}.</p>`
    }`} />`;
}
