// The few numbers of a fit that stand above everything else.
import { html } from '../html.js';
import { fixed } from '../format.js';
import { Verdict } from './status.js';
import { explained } from './term.js';
import { forecasts, outputIn } from './outputs.js';

const PLAIN = [
  ['validation, free run', 'validation_rmse'],
  ['train, free run', 'train_rmse'],
];

/** Of one output; each output with its error on unseen data where all are looked at. */
export function Figures({ fit, query = {} }) {
  const chosen = outputIn(query, fit.metrics, true);
  const metrics = fit.metrics[chosen];
  return html`<dl class="figures">
    ${metrics && forecasts(fit.metrics) && html`<div><dt>${explained('24 h ahead')}</dt><dd>${fixed(metrics.ahead?.PT24H?.rmse)} ${metrics.unit}</dd></div>`}
    ${
      metrics
        ? PLAIN.map(([title, key]) => html`<div><dt>${explained(title)}</dt><dd>${fixed(metrics[key])} ${metrics.unit}</dd></div>`)
        : Object.entries(fit.metrics).map(
            ([name, entry]) => html`<div><dt>${explained(`${name}, unseen data`)}</dt><dd>${fixed(entry.validation_rmse)} ${entry.unit}</dd></div>`,
          )
    }
    <div><dt>model</dt><dd>${fit.model}</dd></div>
    <div><dt>${explained('verdict')}</dt><dd><${Verdict} fit=${fit} /></dd></div>
    ${chosen && html`<div><dt>error of</dt><dd>${chosen}</dd></div>`}
  </dl>`;
}
