// What all windows show together: its screens, its order, and its numbers behind the chart.
import { ask, holds, test } from './harness.js';

const SYSTEM = 'room/7';
const PLACE = /\/systems\/room\/7\/evidence\?/;

/** An effect that these windows show, `[first day of a fortnight in January 2026, size, pooled]`, newest first. */
function effect(name, t, windows) {
  const at = day => new Date(Date.UTC(2026, 0, day)).toISOString().replace('.000Z', 'Z');
  const rows = windows.map(([day, size, pooled]) => ({
    diagnosis: 'dia_0', from: at(day), to: at(day + 14), hours: 12, effect: name, size, deviation: 0.05, unit: 'K/(h*kW)', share: 0.2,
    t: size / 0.05, beyond_clock: size / 0.06, days: 14, shift_p: 0.05, pooled, apart: pooled ? null : 'overlaps',
  }));
  const pooled = {
    windows: 2, from: at(1), to: at(29), t, beyond_clock: t, size: 0.25, deviation: 0.035, ci95: [0.18, 0.32], unit: 'K/(h*kW)', q: 1, i2: 0,
    share: 0.2, shift_p: 0.02, sentence: `In 2 windows it is ${name}.`, taken_back: null,
  };
  return { effect: name, model: 'rc2', windows: rows, pooled };
}

export async function ledger(chrome, { base }) {
  await test(chrome, 'what_windows_show_together_is_drawn_by_effect_and_said', {}, async page => {
    const place = `${base}/ui/systems/${SYSTEM}/missing`;
    const section = page.getByRole('region', { name: 'What all windows show together' });
    let answer = route => route.fulfill({ json: { system: SYSTEM, effects: [] } });
    await page.route(PLACE, route => answer(route));
    await page.goto(place);
    await section.getByText('No window has been added up yet').waitFor();
    answer = route => route.fulfill({ status: 503, json: { type: 'unavailable', title: 'Unavailable', status: 503, detail: 'not now' } });
    await page.reload();
    await section.getByRole('alert').getByText('not now').waitFor();
    const strong = effect('metered_gain:P', 7, [[15, 0.3, true], [8, 0.28, false], [1, 0.2, true]]);
    const faint = effect('wind_infiltration', 0.4, [[15, 0.01, true], [1, 0.02, true]]);
    answer = route => route.fulfill({ json: { system: SYSTEM, effects: [strong, faint] } });
    await section.getByRole('button', { name: 'Try again' }).click();
    const chart = section.getByRole('img', { name: 'metered_gain:P. In 2 windows it is metered_gain:P.' });
    await chart.waitFor();
    holds((await chart.locator('circle').count()) === 3, 'a window is missing');
    // What may be chance is shown to those who ask, with the keyboard as well.
    const other = section.getByRole('img', { name: /^wind_infiltration/ });
    holds(!(await other.isVisible()), 'what may be chance is shown at once');
    await section.getByText('Show all: 1 more').focus();
    await page.keyboard.press('Enter');
    await other.waitFor();
    await section.getByRole('button', { name: 'Table' }).click();
    holds((await section.locator('tbody tr').count()) === 7, 'every window and what they show together is a row');
    await section.getByRole('cell', { name: 'no: overlaps' }).waitFor();
  });

  await test(chrome, 'the_service_tells_the_page_of_every_window', {}, async page => {
    const { system, effects } = await ask(base, `/systems/${SYSTEM}/evidence`);
    holds(system === SYSTEM && Array.isArray(effects), JSON.stringify({ system }));
    await page.goto(`${base}/ui/systems/${SYSTEM}/missing`);
    const said = effects.length ? 'Effects by window' : 'No window has been added up yet';
    await page.getByRole('region', { name: 'What all windows show together' }).getByText(said).waitFor();
  });
}
