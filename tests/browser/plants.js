// A treatment plant on the page: four outputs in g/m3, and a model that forecasts nothing.
import { ask, holds, test } from './harness.js';

const PLANT = '/ui/systems/plant/north';
const OUTPUTS = ['S_S_e', 'X_S_e', 'S_NH_e', 'S_NO_e'];

/** Where the page counts in kelvin, which nothing in an effluent is. */
const kelvin = page =>
  page.evaluate(() => [...document.querySelector('main').innerText.matchAll(/.{0,40}(?<=[\d\s(])(K|degC|K\/h)(?=[\s,.);]|$).{0,20}/g)].map(([text]) => text));

/** How many points of a chart have the colour of measurements. */
const inked = (page, index) =>
  page.evaluate(at => {
    const canvas = document.querySelectorAll('.strips canvas')[at];
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) if (data[i + 3] > 200 && Math.max(data[i], data[i + 1], data[i + 2]) < 70) count += 1;
    return count;
  }, index);

export async function plants(chrome, { base }) {
  await test(chrome, 'a_plant_opens_on_the_output_that_fails_most_and_its_flow_sheet_chooses', {}, async page => {
    const { metrics } = (await ask(base, '/fits?system=plant/north')).items.find(fit => fit.served);
    const worst = OUTPUTS.toSorted((a, b) => metrics[b].rho - metrics[a].rho)[0];
    await page.goto(`${base}${PLANT}`);
    await page.getByRole('figure', { name: `Measured and model, ${worst}` }).waitFor();
    const tags = page.locator('svg.flowsheet [role=button]');
    holds((await tags.count()) === OUTPUTS.length, `${await tags.count()} outputs on the flow sheet`);
    holds((await tags.allTextContents()).every(text => /[●▲■]/.test(text) && /\d ×/.test(text)), (await tags.allTextContents()).join());
    for (const part of ['anoxic', 'aerobic', 'settler', 'effluent']) await page.locator('svg.flowsheet text', { hasText: part }).first().waitFor();
    await page.locator('svg.flowsheet').getByRole('button', { name: /X_S_e/ }).focus();
    await page.keyboard.press('Enter');
    await page.getByRole('figure', { name: 'Measured and model, X_S_e' }).waitFor();
    await page.goto(`${base}${PLANT}/fails`);
    await page.getByRole('heading', { name: `Error by day and hour, ${worst}` }).waitFor();
  });

  await test(chrome, 'the_outputs_of_a_plant_are_below_each_other_where_all_are_asked_for', {}, async page => {
    await page.goto(`${base}${PLANT}?output=all`);
    await page.locator('.strips canvas').first().waitFor();
    const strips = page.locator('.strips .strip');
    const names = (await strips.locator('.legend b').allInnerTexts()).filter(name => OUTPUTS.includes(name));
    holds(names.join() === OUTPUTS.join(), names.join());
    // The sensors sample half as often as the inputs, and their lines are lines all the same.
    for (const at of OUTPUTS.keys()) {
      const legend = await strips.nth(2 * at).locator('.legend').innerText();
      holds(legend.includes(OUTPUTS[at]) && legend.includes('g/m3'), legend);
      const points = await inked(page, 2 * at);
      holds(points > 400, `${OUTPUTS[at]} is drawn with ${points} points`);
    }
    await page.getByText(/Never changing, and not drawn: .*S_ALK 7 mol\/m3/).waitFor();
    const all = await strips.count();
    // One after another by a key, all again behind the last.
    for (const name of OUTPUTS) {
      await page.keyboard.press('o');
      await page.waitForURL(`**output=${name}`);
      holds((await page.getByRole('button', { name, exact: true }).getAttribute('aria-pressed')) === 'true', `${name} is not marked`);
      holds((await strips.count()) === all - 6, `${await strips.count()} strips of ${all}`);
      const rows = await page.getByRole('region', { name: 'Errors of this view' }).locator('tbody th').allInnerTexts();
      holds(rows.length > 0 && rows.every(row => row.startsWith(`${name},`)), rows.join());
    }
    await page.keyboard.press('o');
    await page.waitForURL('**output=all');
    holds((await strips.count()) === all, 'not all come again');
    // The button does the same from the keyboard, and the choice goes along to the other pages and over a reload.
    await page.getByRole('button', { name: 'S_NH_e', exact: true }).focus();
    await page.keyboard.press('Enter');
    await page.waitForURL('**output=S_NH_e');
    await page.keyboard.press('2');
    await page.waitForURL('**/fails?*output=S_NH_e*');
    await page.reload();
    await page.getByRole('heading', { name: 'Error by day and hour, S_NH_e' }).waitFor();
    await page.keyboard.press('o');
    await page.getByRole('heading', { name: 'Error by day and hour, S_NO_e' }).waitFor();
    await page.getByText('lower than the model says', { exact: true }).waitFor();
    const table = await page.getByRole('region', { name: 'Free run of each output' }).locator('tbody tr').allInnerTexts();
    holds(table.length === 4 && table.every(row => row.includes('g/m3')), table.join('\n'));
  });

  await test(chrome, 'a_plant_counts_in_grams_and_forecasts_nothing', {}, async page => {
    const [fit] = (await ask(base, '/fits?system=plant/north')).items;
    await page.goto(`${base}${PLANT}?mode=PT6H&output=all`);
    await page.getByText('so it makes no forecasts').first().waitFor();
    await page.locator('.strips canvas').first().waitFor();
    holds((await page.getByRole('button', { name: '6 h ahead' }).count()) === 0, 'forecasts are offered');
    const figures = await page.locator('dl.figures').first().innerText();
    for (const name of OUTPUTS) holds(figures.includes(`${name}, unseen data`), figures);
    holds(fit.metrics.S_NH_e.unit === 'g/m3' && !figures.includes('24 h ahead'), figures);
    const ready = { '': '.strips canvas', '/fails': 'svg.heat', '/missing': '.screen.empty', '/ladder': '.screen.empty', '/parameters': 'svg.rail' };
    for (const [tab, part] of Object.entries(ready)) {
      await page.goto(`${base}${PLANT}${tab}`);
      await page.locator(part).first().waitFor();
      // What the gate demands of a fit is its own text.
      await page.evaluate(() => document.querySelectorAll('[aria-label="Checks"]').forEach(checks => checks.remove()));
      const found = await kelvin(page);
      holds(found.length === 0, `${tab}: ${found.join(' | ')}`);
    }
    await page.goto(`${base}/ui/`);
    const row = page.locator('table.systems tbody tr', { hasText: 'plant/north' });
    await row.getByText(/free run of S_NO_e/).first().waitFor();
    await row.getByText(/last [\d.]+ g\/m3 of S_S_e/).waitFor();
  });

  await test(chrome, 'a_ridge_is_drawn_with_its_numbers', {}, async page => {
    // The two free parameters of the demo's plant can be told apart: its fit gets a pair that cannot.
    const ridge = [[3.1, 0.42], [3.3, 0.46], [3.6, 0.5], [3.9, 0.53], [4.3, 0.57]].map((values, at) => ({ values, cost: 1 + 0.01 * (at - 2) ** 2 }));
    await page.route(/\/fits\/[^/?]+$/, async route => {
      const answer = await route.fetch();
      const fit = await answer.json();
      const parameters = Object.keys(fit.parameters).slice(0, 2);
      await route.fulfill({ response: answer, json: { ...fit, correlated: [{ parameters, correlation: 0.991, ridge }] } });
    });
    await page.goto(`${base}${PLANT}/parameters`);
    await page.getByText('Along the ridge').click();
    const open = page.locator('details[open]', { hasText: 'Along the ridge' });
    for (const at of [0, 1]) await open.locator('svg.chart path').nth(at).waitFor();
    const rows = await open.locator('tbody tr').allInnerTexts();
    holds(rows.length === ridge.length && rows[2].includes('3.6') && rows[2].includes('0.5'), rows.join('\n'));
  });
}
