// Whether anything is left in the residuals: with which input they go, and what the innovations do over time.
import { html } from '../html.js';
import { number, signed, percent } from '../format.js';
import { Frame } from '../parts/frame.js';
import { Term } from '../parts/term.js';
import { Bars } from '../charts/bars.js';
import { Curve } from '../charts/curve.js';

const ACF_SHOWN = 48;
/** Below this no curve of a correlation fills its chart. */
const LEAST_RANGE = 0.3;
const HOURS = [0, 6, 12, 18, 24];

/** Longest lag in hours within which a channel is said to go with the error: a day on, the same hour comes again. */
const NEAR_HOURS = 6;

/**
 * What a curve shows, in words and as marks on it: where it is strongest within six hours, which ranks the channels, and where over
 * the whole day if that is elsewhere.
 */
function saidOf(input) {
  const points = [...input.correlations.map((value, at) => [input.lags_hours[at], value]), [input.lag_hours, input.correlation]]
    .sort((a, b) => a[0] - b[0]);
  const [lag, value] = points.reduce((most, point) => (Math.abs(point[1]) > Math.abs(most[1]) ? point : most));
  const at = (size, hours) => `${signed(size, 2)} at ${period(hours)}`;
  const near = `${at(input.correlation, input.lag_hours)}, strongest within ${NEAR_HOURS} h`;
  return lag <= NEAR_HOURS
    ? { points, near, dots: [[input.lag_hours, input.correlation]] }
    : { points, near, far: `${at(value, lag)} over the day`, dots: [[input.lag_hours, input.correlation], [lag, value]] };
}

/** The free-run residual against each channel by lag, a small chart for each. */
export function ByLag({ inputs: all, output, about, path }) {
  // What never changes goes with nothing.
  const inputs = all.filter(input => input.correlations.some(value => value !== 0));
  const still = all.filter(input => !inputs.includes(input)).map(input => input.channel);
  if (inputs.length === 0) return null;
  const most = Math.max(LEAST_RANGE, ...inputs.flatMap(input => input.correlations.map(Math.abs)));
  const says = inputs
    .slice(0, 3)
    .map(
      input =>
        `${input.channel} ${signed(input.correlation, 2)} at ${number(input.lag_hours)} h${input.feedback ? ' (closed loop: weaker evidence)' : ''}`,
    )
    .join(', ');
  const lags = inputs[0].lags_hours;
  return html`<${Frame} title=${`Residual of ${output} against each channel, by lag`} about=${about} path=${path}
    summary=${`Strongest within ${NEAR_HOURS} h: ${says}.`}
    note=${`How the free-run error (measured − model) goes with what a channel was so many hours before; rings mark what is said above a curve. Channels come in the order of their strongest correlation of either sign within ${NEAR_HOURS} h. It names companions, no causes, and is no evidence by itself: such errors depend on their own past, so that chance alone gives large correlations, and the same hour comes again after a day.${
      inputs.some(input => input.feedback) ? ' Closed loop: a controller may move this input by the very output, which is weaker evidence still.' : ''
    }${still.length ? ` Never changing, and not shown: ${still.join(', ')}.` : ''}`}
    table=${() => ({
      columns: [['lag, h', 'number'], ...inputs.map(input => [input.channel, 'number'])],
      rows: lags.map((lag, at) => [number(lag), ...inputs.map(input => number(input.correlations[at]))]),
    })}>
    <div class="small-multiples">${inputs.map(input => {
      const { points, near, far, dots } = saidOf(input);
      return html`<section>
        <p><b>${input.channel}</b> ${input.feedback && html` <${Term} class="flag" of="closed loop">closed loop: weaker evidence</${Term}>`}<br />
          <span class="quiet">${near}${far ? `; ${far}` : ''}</span></p>
        <${Curve} height=${130} range=${[-most, most]} at=${HOURS} zero dots=${dots} xLabel="lag, h" yLabel="correlation"
          lines=${[{ colour: 'model', open: true, points }]} label=${`${input.channel}: ${near}${far ? `; ${far}` : ''}.`} />
      </section>`;
    })}</div>
  </${Frame}>`;
}

/** The one-step innovations by lag and by frequency. */
export function Innovations({ data, output, about, path, rho, floor, unit }) {
  const shown = data.acf.slice(0, ACF_SHOWN);
  if (shown.length === 0) return null;
  const outside = shown.filter(value => Math.abs(value) > data.acf_band).length;
  const peak = shown.reduce((most, value, at) => (Math.abs(value) > Math.abs(shown[most]) ? at : most), 0);
  const says = `One-step errors of ${output} against themselves: ${outside} of ${shown.length} lags lie outside of what chance alone would give (±${number(data.acf_band)}), the strongest ${signed(shown[peak], 2)} at ${period((peak + 1) * data.step_hours)}.`;
  return html`
    <p class="note">What follows is of the <${Term} of="innovation">one-step errors</${Term}>, whose <${Term} of="noise floor">noise floor</${Term}> is ${number(floor)} ${unit}. They must look like noise in a good model, and
      may do so in a bad one. The free run errs by <${Term} of="rho">${number(rho)} times</${Term}> the noise that is left in it${rho > 1.6 ? ': something physical is probably missing' : ''}.</p>
    <div class="grid">
      <${Frame} title="Innovations: autocorrelation" about=${about} path=${path} summary=${says} note=${says}
        table=${() => ({
          columns: [
            ['lag, samples', 'number'],
            ['lag, h', 'number'],
            ['autocorrelation', 'number'],
          ],
          rows: data.acf.map((value, lag) => [lag + 1, number((lag + 1) * data.step_hours), number(value)]),
        })}>
        <${Bars} values=${shown} first=${1} band=${data.acf_band} height=${230} xLabel=${`lag, samples of ${number(60 * data.step_hours)} min`}
          yLabel="correlation" label=${says} />
      </${Frame}>
      <${Periodogram} data=${data} about=${about} path=${path} />
    </div>`;
}

/** A period as people say it. */
const period = hours => (hours >= 48 ? `${number(hours / 24)} d` : hours > 0 && hours < 1 ? `${number(60 * hours)} min` : `${number(hours)} h`);

function Periodogram({ data, about, path }) {
  const { distance_limit: limit } = data;
  const last = data.cycles_per_day.at(-1);
  const within = value => Math.min(Math.max(value, 0), 1);
  const band = Array.from({ length: 101 }, (_, at) => [(last * at) / 100, within(at / 100 - limit), within(at / 100 + limit)]);
  const peaks = data.peaks.map(peak => ({ x: 24 / peak.period_hours, text: `${period(peak.period_hours)}: ${percent(peak.share)}` }));
  const leaves = data.largest_distance > limit;
  const says = `Largest distance from the straight line of white noise ${number(data.largest_distance)}; 95 % of white noise stays below ${number(limit)}. ${
    data.peaks.length > 0
      ? `Periods that stand out: ${data.peaks.map(peak => `${period(peak.period_hours)} with ${percent(peak.share)} of the power`).join(', ')}.`
      : 'No single period stands out.'
  }`;
  return html`<${Frame} title="Innovations: cumulated periodogram" about=${about} path=${path} summary=${says}
    note=${`${leaves ? '▲ It leaves the band. ' : ''}${says}`}
    table=${() => ({
      columns: [
        ['cycles a day', 'number'],
        ['period', 'number'],
        ['share of the power up to here', 'number'],
      ],
      rows: data.cycles_per_day.map((cycles, at) => [number(cycles), period(24 / cycles), number(data.cumulated_periodogram[at])]),
    })}>
    <${Curve} height=${230} range=${[0, 1]} band=${band} peaks=${peaks} xLabel="cycles a day" yLabel="share of the power" label=${says}
      lines=${[
        { label: 'innovations', colour: 'model', open: true, points: data.cycles_per_day.map((x, at) => [x, data.cumulated_periodogram[at]]) },
        {
          label: 'white noise, with its 95 % band',
          colour: 'strong-edge',
          dash: '4 4',
          open: true,
          points: [
            [0, 0],
            [last, 1],
          ],
        },
      ]} />
  </${Frame}>`;
}
