// The charts that a modeller believes a finding by, or does not: their numbers are those of the service.
import { ask, holds, test } from './harness.js';

const HIDES_TWO = 'room/7';
/** A real house whose day the innovations still know, and whose heater a thermostat moves. */
const KNOWS_THE_DAY = 'room/5';

export async function evidence(chrome, { base }) {
  await test(chrome, 'each_finding_shows_the_error_beside_its_shape', {}, async page => {
    await page.goto(`${base}/ui/systems/${HIDES_TWO}/missing`);
    const [{ id }] = (await ask(base, `/diagnoses?system=${HIDES_TWO}`)).items;
    const { findings } = await ask(base, `/diagnoses/${id}`);
    for (const { title, shape } of findings) {
      const lines = page.getByRole('figure', { name: `${title}: the unexplained error beside its shape` });
      await lines.locator('canvas').waitFor();
      await lines.getByRole('button', { name: 'Table' }).click();
      const at = shape.unexplained.findIndex(value => value !== null);
      const row = lines.getByRole('row', { name: shape.time[at] });
      const told = (await row.getByRole('cell').allInnerTexts()).join();
      holds(told === `${shape.unexplained[at]},${shape.effect[at]}`, `${told} beside ${shape.unexplained[at]},${shape.effect[at]}`);
      const points = page.getByRole('figure', { name: `${title}: unexplained by what it would add` }).locator('svg.chart circle');
      holds((await points.count()) === shape.added.bins.length, `${await points.count()} points`);
      const across = await points.evaluateAll(all => all.map(point => Number(point.getAttribute('cx'))));
      holds(
        across.every((x, place) => place === 0 || x > across[place - 1]),
        'the points are not in the order of their bins',
      );
    }
  });

  await test(chrome, 'what_flows_unseen_stands_beside_the_channels_and_events_lead_to_their_hours', {}, async page => {
    await page.goto(`${base}/ui/systems/${HIDES_TWO}/missing`);
    const [{ id }] = (await ask(base, `/diagnoses?system=${HIDES_TWO}`)).items;
    const heat = await ask(base, `/diagnoses/${id}/missing-heat`);
    const chart = page.getByRole('figure', { name: 'Missing, hour by hour' });
    await chart.locator('.strip', { hasText: 'P_appliances' }).locator('canvas').waitFor();
    await chart.getByRole('button', { name: 'Table' }).click();
    const known = heat.hours.filter(hour => hour.rate !== null);
    const first = chart.locator('.numbers tbody tr').first();
    const told = (await first.getByRole('cell').allInnerTexts()).map(Number);
    const hour = [known[0].rate, ...known[0].band_50, ...known[0].band_95];
    holds(
      told.length === hour.length && told.every((value, at) => Math.abs(value - hour[at]) < 1e-3 * Math.abs(hour[at]) + 1e-6),
      `${told} beside ${hour}`,
    );
    // The largest event comes first, and leads to its hours in the chart.
    const largest = heat.events.reduce((most, event) => (Math.abs(event.sum) > Math.abs(most.sum) ? event : most));
    const row = page.getByRole('table', { name: 'largest of' }).locator('tbody tr').first();
    holds((await row.innerText()).includes(`${largest.hours} h`), await row.innerText());
    await row.getByRole('button', { name: 'above' }).click();
    const shown = new URL(page.url()).searchParams;
    const at = Date.parse(largest.from);
    holds(Date.parse(shown.get('from')) < at && at < Date.parse(shown.get('to')), page.url());
    await page.getByRole('figure', { name: 'Missing in a mean week' }).locator('svg.chart path').first().waitFor();
  });

  await test(chrome, 'a_term_is_proposed_on_demand_with_its_document_and_what_it_leaves', {}, async page => {
    await page.goto(`${base}/ui/systems/${HIDES_TWO}/missing`);
    const [{ fit }] = (await ask(base, `/diagnoses?system=${HIDES_TWO}`)).items;
    const part = page.getByRole('region', { name: 'A term that no catalogue has' });
    await part.getByRole('button', { name: 'Propose a term' }).click();
    const found = await ask(base, `/fits/${fit}/proposals`);
    await part.getByText(found.sentences[0].slice(0, 60)).first().waitFor();
    holds((await part.getByText(`${found.tried} terms were tried`).count()) === 1, 'how many were tried');
    const articles = part.getByRole('article');
    holds((await articles.count()) === found.proposals.length, `${await articles.count()} beside ${found.proposals.length}`);
    for (const one of found.proposals) {
      const article = part.getByRole('article', { name: one.effect, exact: true });
      await article.getByText('The document').click();
      holds((await article.locator('pre').innerText()).trim() === one.toml.trim(), one.toml);
      holds((await article.getByRole('button', { name: 'Add it and refit' }).count()) === 1, 'it can be added');
    }
  });

  await test(chrome, 'residuals_by_lag_and_by_frequency_are_charts_with_their_numbers', {}, async page => {
    const [{ id }] = (await ask(base, `/fits?system=${KNOWS_THE_DAY}&page_size=1`)).items;
    const told = await ask(base, `/fits/${id}/diagnostics`);
    await page.goto(`${base}/ui/systems/${KNOWS_THE_DAY}/fails?fit=${id}`);
    const lags = page.getByRole('figure', { name: 'Residual of T_room against each channel, by lag' });
    await lags.locator('svg.chart').first().waitFor();
    holds((await lags.locator('svg.chart').count()) === told.residual_by_input.length, 'an input is missing');
    const marked = await lags.locator('section', { hasText: 'closed loop: weaker evidence' }).locator('b').allInnerTexts();
    const moved = told.residual_by_input.filter(input => input.feedback).map(input => input.channel);
    holds(moved.length > 0 && marked.join() === moved.join(), `${marked} beside ${moved}`);
    // What stands above a curve is where the curve is largest, and where over the first six hours.
    for (const { channel, correlations, lags_hours: hours } of told.residual_by_input) {
      const peak = correlations.reduce((most, value, at) => (Math.abs(value) > Math.abs(correlations[most]) ? at : most), 0);
      const says = await lags.locator('section', { hasText: channel }).first().locator('p').innerText();
      const size = Math.abs(correlations[peak]).toFixed(2);
      holds(says.includes(size) && (hours[peak] <= 6 || says.includes(`at ${hours[peak]} h over the day`)), `${says}: the curve has ${size} at ${hours[peak]} h`);
    }
    const periodogram = page.getByRole('figure', { name: 'Innovations: cumulated periodogram' });
    await periodogram.locator('svg.chart text', { hasText: /^24 h: \d+ %$/ }).waitFor();
    await periodogram.getByRole('button', { name: 'Table' }).click();
    await periodogram.getByRole('columnheader', { name: 'cycles a day' }).waitFor();
    const rows = await periodogram.locator('tbody tr').count();
    holds(rows === told.innovations.cycles_per_day.length, `${rows} rows`);
  });
}
