// The story: see which room fails, where, what it lacks; add that, and watch the error fall.
import { ask, holds, test } from './harness.js';

export async function story(chrome, { base }) {
  await test(chrome, 'the_overview_shows_every_system_worst_first', {}, async page => {
    await page.goto(`${base}/`);
    await page.waitForURL('**/ui/');
    const rows = page.locator('table.systems tbody tr');
    await rows.nth(4).waitFor();
    const systems = (await ask(base, '/systems')).items;
    holds((await rows.count()) === systems.length, 'a row is missing');
    const worst = systems.find(system => system.health === 'bad');
    holds((await rows.first().innerText()).includes(worst.system), `the worst is ${worst.system}`);
    holds((await rows.first().innerText()).includes(worst.why), 'it does not say why');
    // Eleven rows of the tallest kind and what is above them fit into 768 pixels.
    const tallest = Math.max(...(await rows.evaluateAll(all => all.map(row => row.getBoundingClientRect().height))));
    const top = await rows.first().evaluate(row => row.getBoundingClientRect().top);
    holds(top + 11 * tallest <= 768, `eleven rows need ${top + 11 * tallest} pixels`);
    await page.getByRole('button', { name: /1 bad/ }).click();
    holds((await rows.count()) === 1 && page.url().includes('health=bad'), 'the filter is not in the address');
  });

  await test(chrome, 'from_the_failing_room_to_an_error_that_falls_without_a_reload', {}, async page => {
    await page.goto(`${base}/ui/`);
    await page.evaluate(() => {
      window.neverReloaded = true;
    });
    const clicked = Date.now();
    await page.getByRole('link', { name: 'room/5' }).click();
    await page.locator('.strips canvas').first().waitFor();
    console.log(`  the first view of room/5 is drawn ${Date.now() - clicked} ms after the click`);

    await page.getByRole('tab', { name: 'Where it fails' }).click();
    await page.locator('svg.heat rect.cell').first().waitFor();
    holds((await page.locator('svg.heat rect.cell').count()) > 500, 'the map of hours is empty');
    await page.getByText('Its error is', { exact: false }).first().waitFor();
    await page
      .getByRole('button', { name: /^Show .* in the chart/ })
      .first()
      .click();
    await page.locator('.strips canvas').first().waitFor();
    holds(page.url().includes('from='), 'an episode does not zoom the chart');

    await page.getByRole('tab', { name: 'What is missing' }).click();
    await page.locator('main').getByRole('button', { name: 'Find what is missing' }).last().click();
    await page.getByRole('heading', { name: /2\. People/ }).waitFor();
    const findings = await page.locator('article.finding').count();
    await page.getByRole('button', { name: 'Add and refit: People' }).click();
    await page.locator('.equation ins').first().waitFor();
    await page.getByText(/The error on unseen data fell by \d+ %/).waitFor();
    holds(findings === (await page.locator('article.finding').count()), 'the findings went away');
    holds(await page.evaluate(() => window.neverReloaded), 'the page was loaded anew');

    // What the page says is what the service computed.
    const [fit] = (await ask(base, '/fits?system=room/5&page_size=1')).items;
    const fell = await page.locator('.outcome .says').innerText();
    holds(fell.includes(fit.metrics.T_room.validation_rmse.toFixed(3)), `${fell} beside ${fit.metrics.T_room.validation_rmse}`);
    holds(fit.model === 'tite+occupancy_gain', fit.model);
    holds((await page.locator('svg.ladder path.mark, svg.ladder circle').count()) >= 2, 'there is no ladder');
    // The address carries the step: another browser sees the same.
    await page.reload();
    await page.getByText(/The error on unseen data fell by \d+ %/).waitFor();

    await page.getByRole('button', { name: 'Use tite+occupancy_gain for the controller' }).click();
    await page
      .getByText(/Fit of tite\+occupancy_gain for the controller/)
      .first()
      .waitFor();
    await page.locator('section.card .status', { hasText: 'succeeded' }).nth(1).waitFor();
    holds((await ask(base, '/systems/room/5')).model === 'tite+occupancy_gain', 'the model of the system is another');
  });

  await test(chrome, 'an_effect_that_does_not_help_is_said_as_plainly', {}, async page => {
    const { system: _, ...document } = await ask(base, '/systems/room/5');
    await ask(base, '/systems/room/5', { ...document, model: 'tite' }, 'PUT');
    const [diagnosis] = (await ask(base, '/diagnoses?system=room/5')).items.filter(entry => entry.model === 'tite');
    await page.goto(`${base}/ui/systems/room/5/missing?diagnosis=${diagnosis.id}`);
    await page.getByRole('button', { name: 'Add and refit: Sensor lag' }).click();
    await page.getByText(/The error did not fall: /).waitFor();
    await page.getByRole('button', { name: 'Take it out again' }).click();
    await page.getByText(/The error did not fall/).waitFor({ state: 'detached' });
    holds(!page.url().includes('steps='), 'the step is still in the address');
  });

  await test(chrome, 'the_ladder_is_climbed_live', {}, async page => {
    await page.goto(`${base}/ui/systems/room/5/ladder`);
    await page.getByRole('button', { name: 'Climb the ladder' }).click();
    await page
      .getByText(/the error on unseen data falls from|The error did not fall/)
      .first()
      .waitFor();
    const ladder = await ask(base, '/systems/room/5/ladder');
    holds((await page.locator('svg.ladder text', { hasText: /^(tite|\+ )/ }).count()) === ladder.steps.length, 'a step is missing');
    for (const step of ladder.steps) await page.getByText(step.why, { exact: true }).first().waitFor();
  });

  await test(chrome, 'a_set_is_pinned_with_a_reason_and_released', {}, async page => {
    await page.goto(`${base}/ui/systems/room/3/parameters`);
    await page.getByRole('button', { name: 'Keep it in service (pin)' }).click();
    await page.getByLabel('Reason, for whoever reads this later').fill('sensor swap this week');
    await page.getByRole('button', { name: 'Keep it', exact: true }).click();
    await page
      .getByText(/sensor swap this week/)
      .first()
      .waitFor();
    const pinned = await ask(base, '/params/room/3');
    holds(pinned.status === 'pinned' && pinned.pin.reason === 'sensor swap this week', pinned.status);
    await page.getByRole('button', { name: 'Release it' }).click();
    await page.getByRole('button', { name: 'Keep it in service (pin)' }).waitFor();
    await page.getByText('G3 time constants').first().waitFor();
  });
}
