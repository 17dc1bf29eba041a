// The few numbers of a fit that stand above everything else.
import { html } from '../html.js';
import { withUnit } from '../format.js';
import { Status } from './status.js';

export function Figures({ fit }) {
  const [output, metrics] = Object.entries(fit.metrics)[0];
  return html`<dl class="figures">
    <div><dt>24 h ahead</dt><dd>${withUnit(metrics.ahead?.PT24H?.rmse, metrics.unit)}</dd></div>
    <div><dt>validation, free run</dt><dd>${withUnit(metrics.validation_rmse, metrics.unit)}</dd></div>
    <div><dt>train, free run</dt><dd>${withUnit(metrics.train_rmse, metrics.unit)}</dd></div>
    <div><dt>model</dt><dd>${fit.model}</dd></div>
    <div><dt>verdict</dt><dd><${Status} of=${fit.verdict ?? 'unknown'} /></dd></div>
    <div><dt>error of</dt><dd>${output}</dd></div>
  </dl>`;
}
