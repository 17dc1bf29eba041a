// A new system: a name and a model; its measurements come next.
import { html, useState } from '../html.js';
import { useList, put } from '../api.js';
import { go, systemAddress } from '../router.js';
import { say } from '../say.js';
import { NotSaved } from '../parts/screens.js';

export function NewSystem() {
  const models = useList('/models');
  const [draft, setDraft] = useState({ system: 'room/', label: '', model: 'room2' });
  const [error, setError] = useState(null);
  const set = name => event => setDraft({ ...draft, [name]: event.target.value });
  const make = async event => {
    event.preventDefault();
    try {
      await put(`/systems/${draft.system}`, { label: draft.label, model: draft.model }, { isNew: true });
      say(`${draft.system} is there`);
      go(systemAddress(draft.system, 'data'));
    } catch (fault) {
      setError(Object.assign(fault, { system: draft.system }));
    }
  };
  return html`<h1>Add a system</h1>
    <form class="card" style="max-width:32rem" onSubmit=${make}>
      <label>Name: its kind and a number or word<input value=${draft.system} required pattern="[a-z]{1,32}/[A-Za-z0-9_\\-]{1,64}"
        placeholder="room/6" onInput=${set('system')} /></label>
      <label>What people call it<input value=${draft.label} placeholder="Living room" onInput=${set('label')} /></label>
      <label>Model<select value=${draft.model} onChange=${set('model')}>
        ${(models.data ?? [{ id: 'room2', title: '' }]).map(model =>
          html`<option value=${model.id} selected=${model.id === draft.model}>${model.id}: ${model.title}</option>`)}</select></label>
      ${error && html`<${NotSaved} error=${error}><p>There is a system ${error.system} already, and nothing of it was changed. Choose another name,
        or <a href=${systemAddress(error.system, 'settings')}>change the settings of ${error.system}</a>.</p></${NotSaved}>`}
      <p class="row end"><button class="main">Add it and upload measurements</button></p>
    </form>`;
}
