// The few numbers of a fit that stand above everything else.
import { html } from '../html.js';
import { withUnit, fixed } from '../format.js';
import { Verdict } from './status.js';
import { forecasts, outputIn } from './outputs.js';

const PLAIN = [
  ['validation, free run', 'validation_rmse'],
  ['train, free run', 'train_rmse'],
];

/** Of one output; of several outputs each with its error on unseen data, until one is chosen. */
export function Figures({ fit, query = {} }) {
  const outputs = Object.keys(fit.metrics);
  const chosen = outputIn(query, outputs) ?? (outputs.length > 1 ? null : outputs[0]);
  const metrics = fit.metrics[chosen];
  return html`<dl class="figures">
    ${metrics && forecasts(fit.metrics) && html`<div><dt>24 h ahead</dt><dd>${withUnit(metrics.ahead?.PT24H?.rmse, metrics.unit)}</dd></div>`}
    ${
      metrics
        ? PLAIN.map(([title, key]) => html`<div><dt>${title}</dt><dd>${fixed(metrics[key])} ${metrics.unit}</dd></div>`)
        : Object.entries(fit.metrics).map(
            ([name, entry]) => html`<div><dt>${name}, unseen data</dt><dd>${fixed(entry.validation_rmse)} ${entry.unit}</dd></div>`,
          )
    }
    <div><dt>model</dt><dd>${fit.model}</dd></div>
    <div><dt>verdict</dt><dd><${Verdict} fit=${fit} /></dd></div>
    ${chosen && html`<div><dt>error of</dt><dd>${chosen}</dd></div>`}
  </dl>`;
}
