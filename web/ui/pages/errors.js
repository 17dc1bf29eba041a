// The errors of what a chart shows. All numbers of one table come from the same samples, and its caption says from which.
import { html } from '../html.js';
import { number, fixed, clock, horizon, fitName } from '../format.js';
import { Table } from '../parts/table.js';

const ALL = 'all samples';
const OVER = { range: ALL, unseen: 'samples that neither fit was trained on' };

/** Of one fit: each output's errors over the range, and over what each part has of it. */
const rowsOfOne = ({ errors }) =>
  Object.entries(errors).flatMap(([output, error]) =>
    [...Object.entries(error.parts), [ALL, error.range]].flatMap(([over, skill]) =>
      skill ? [{ output, over, unit: error.unit, ...skill }] : [],
    ),
  );

/** Of several fits: the samples that all of them and the measurements have. */
const rowsOfSeveral = ({ errors }, mode) => errors.filter(row => row.horizon === mode).map(row => ({ ...row, over: OVER[row.over] }));

const rowsOf = (judged, mode, chosen) =>
  (judged.fits ? rowsOfSeveral(judged, mode) : rowsOfOne(judged)).filter(row => !chosen || row.output === chosen);

const runOf = mode => (mode === 'free_run' ? 'free run' : `${horizon(mode)} ahead`);
const rangeOf = (judged, zone) => `${clock(judged.from, zone)} to ${clock(judged.to, zone)}`;

/** Range and errors in one line. */
export function errorsInWords(judged, mode, chosen, zone) {
  const isOther = row => judged.fits && row.fit !== judged.fits[0].fit;
  const errors = rowsOf(judged, mode, chosen)
    .filter(row => row.over === ALL)
    .map(row => `${row.output} rmse ${fixed(row.rmse)} ${row.unit}${isOther(row) ? ' of the other fit' : ` over ${row.n} samples`}`);
  return `${rangeOf(judged, zone)} (${zone}), ${runOf(mode)}: ${errors.join(', ')}`;
}

/**
 * `judged` is the answer whose errors are shown: a comparison of one fit, or of several on the same samples. `of` is the
 * resource that asks for it, `fits` are this fit and the one beside it, if any.
 */
export function Errors({ of, judged, fits, chosen, mode, zone }) {
  if (of.error) return html`<p class="note">The errors of this range: ${of.error.detail}</p>`;
  const names = Object.fromEntries(fits.map((fit, at) => [fit.id, at === 0 ? 'this fit' : 'the other']));
  // What was answered for another pair of fits is no answer.
  if (!judged || judged.fits?.some(({ fit }) => !names[fit])) return html`<p class="note">The errors of this range are computed …</p>`;
  const several = Boolean(judged.fits);
  const rows = rowsOf(judged, mode, chosen);
  const title = html`<span class="whole">Errors of what is shown <span class="quiet">${runOf(mode)}, ${rangeOf(judged, zone)}${
    several ? ', only samples that both fits have' : ''}</span></span>`;
  return html`<${Table} caption="Errors of this view" title=${title} rows=${rows.map(row => [
    `${row.output}, ${row.over}`,
    ...(several ? [html`<span title=${fitName(fits.find(fit => fit.id === row.fit) ?? fits[0])}>${names[row.fit]}</span>`] : []),
    row.n,
    ...['rmse', 'bias', 'urmse', 'mae'].map(key => `${fixed(row[key])} ${row.unit}`),
    number(row.r2),
  ])}
    columns=${[['output, samples'], ...(several ? [['fit']] : []), ['samples', 'number'], ['rmse', 'number'], ['bias', 'number'],
      ['rmse without bias', 'number'], ['mean absolute', 'number'], ['r²', 'number']]} />`;
}
