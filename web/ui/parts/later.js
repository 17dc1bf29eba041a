// Pages that are read when somebody goes there, so that the first view does not wait for them.
import { html, useState, useEffect } from '../html.js';
import { Failed, Loading } from './screens.js';

/** `load` imports the module in which the page has this name. */
export function later(load, name) {
  return function Later(props) {
    const [state, setState] = useState({ Page: null, error: null });
    useEffect(() => {
      load().then(
        module => setState({ Page: module[name], error: null }),
        () => setState({ Page: null, error: { title: 'This page could not be read', detail: 'The service may be restarting. Load the page again.' } }),
      );
    }, []);
    if (state.error) return html`<${Failed} error=${state.error} />`;
    return state.Page ? html`<${state.Page} ...${props} />` : html`<${Loading} what="the page" />`;
  };
}
