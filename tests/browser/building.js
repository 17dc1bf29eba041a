// The building by the keyboard, a room that gets its model back, and the report of a night.
import { ask, holds, test } from './harness.js';

/** Has the page believe that every fit passes, and that no fit for a controller can be asked for. */
async function withoutJobs(page) {
  await page.route('**/fits/fit_*', async route => {
    const answer = await route.fetch();
    const fit = await answer.json();
    const metrics = Object.fromEntries(Object.entries(fit.metrics).map(([name, of]) => [name, { ...of, validation_rmse: 1 / fit.model.length, test_rmse: 0 }]));
    await route.fulfill({ response: answer, json: { ...fit, metrics, verdict: 'accepted' } });
  });
  await page.route('**/jobs', route =>
    route.request().postDataJSON()?.experiment ? route.continue() : route.fulfill({ status: 503, json: { title: 'Too busy', detail: 'no place now' } }),
  );
}

export async function building(chrome, { base }) {
  await test(chrome, 'a_room_whose_fit_cannot_be_asked_for_gets_its_model_back', {}, async page => {
    const models = async () => (await ask(base, '/systems?page_size=500')).items.map(row => `${row.system} ${row.model}`).join();
    const before = await models();
    await withoutJobs(page);
    await page.goto(`${base}/ui/building`);
    await page.locator('.lacked li', { hasText: 'Sensor lag' }).getByRole('button', { name: /^Try it in/ }).click();
    const trial = page.getByRole('region', { name: /^Sensor lag in/ });
    await trial.getByText(/Sensor lag: 0 of \d+ took it; \d+ did not \(no place now\)/).waitFor();
    holds((await models()) === before, `${await models()} were ${before}`);
    await trial.getByRole('button', { name: 'Close' }).click();
  });

  await test(chrome, 'the_building_shows_which_rooms_lack_what', {}, async page => {
    const { effects } = await ask(base, '/evidence/matrix');
    const lag = effects.find(effect => effect.effect === 'sensor_lag');
    holds(lag?.lacking > 0, `the demo has no room that lacks a sensor lag: ${JSON.stringify(effects)}`);
    await page.goto(`${base}/ui/`);
    // Keys are heard once the page is drawn.
    await page.locator('table.systems').waitFor();
    await page.keyboard.press('g');
    await page.keyboard.press('b');
    await page.getByRole('listitem').filter({ hasText: 'mean error' }).first().waitFor();
    await page.getByText(lag.sentence.slice(1)).waitFor();
    // Arrow keys walk over the grid, what a cell says is read out and shown, and Enter opens the room.
    const grid = page.getByRole('grid', { name: 'Effects beside rooms' });
    const rows = await grid.getByRole('row').count();
    holds(rows > 2, `the grid has ${rows} rows`);
    const place = () => page.evaluate(() => document.activeElement.dataset.at);
    await grid.locator('a[tabindex="0"]').first().focus();
    await page.keyboard.press('ArrowRight');
    await page.keyboard.press('ArrowDown');
    holds((await place()) === '1,1', `the focus is at ${await place()}`);
    await page.keyboard.press('Home');
    await page.keyboard.press('ArrowUp');
    holds((await place()) === '0,0', `the focus is at ${await place()}`);
    const name = await page.evaluate(() => document.activeElement.getAttribute('aria-label'));
    await page.keyboard.press('Enter');
    await page.waitForURL(`**/ui/systems/${name.split(',')[0]}/missing`);
  });

  await test(chrome, 'a_morning_says_what_the_night_came_to', {}, async page => {
    const { items } = await ask(base, '/nights');
    holds(items.length > 0, 'no schedule has done anything');
    const night = await ask(base, `/nights/${items[0].night}`);
    await page.goto(`${base}/ui/mornings`);
    await page.locator('tbody a').first().click();
    await page.getByText(night.summary).waitFor();
    await page.getByRole('heading', { name: 'What to do next' }).waitFor();
    holds((await page.locator('ol.next > li').count()) === night.next.length, 'steps are left out');
    const mail = await fetch(`${base}/nights/${items[0].night}`, { headers: { accept: 'text/html' } });
    const shown = await page.context().newPage();
    await shown.setContent(await mail.text());
    await shown.getByText(night.summary).waitFor();
  });
}
