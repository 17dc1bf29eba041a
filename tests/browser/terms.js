// Words explain themselves, by the pointer and by the keyboard, from the glossary of the book.
import { ask, holds, test } from './harness.js';

// Waits for the line about a system, which comes above the rest and would move it away from under the pointer.
async function systemLine(page, base, system) {
  const [{ why }] = (await ask(base, `/systems?systems=${system}`)).items;
  await page.locator('main p', { hasText: why.slice(0, 20) }).first().waitFor();
}

export async function terms(chrome, { base }) {
  await test(chrome, 'a_word_says_what_it_means_where_it_stands', {}, async page => {
    await page.goto(`${base}/ui/systems/room/5/fails`);
    const word = page.getByRole('button', { name: 'holding the last value' });
    const tip = page.getByRole('tooltip');
    await systemLine(page, base, 'room/5');
    await word.hover();
    await tip.filter({ hasText: 'holds the last measured value' }).waitFor();
    await page.keyboard.press('Escape');
    await tip.waitFor({ state: 'detached' });
    // With the keyboard from the column before, whose own meaning opens and has a link on the way.
    await page.mouse.move(0, 0);
    await page.getByRole('button', { name: 'rmse', exact: true }).last().focus();
    await tip.getByRole('link', { name: 'Glossary' }).waitFor();
    await page.keyboard.press('Tab');
    await page.keyboard.press('Tab');
    await tip.filter({ hasText: 'holds the last measured value' }).waitFor();
    holds((await word.getAttribute('aria-describedby')) === (await tip.getAttribute('id')), 'the word does not lead to its meaning');
    await page.keyboard.press('Tab');
    await page.keyboard.press('Enter');
    await page.waitForURL(/glossary.html#persistence$/);
    await page.locator('h3#persistence').waitFor();
  });

  await test(chrome, 'codes_are_said_in_words_with_the_code_behind_them', {}, async page => {
    await page.goto(`${base}/ui/systems/room/5/parameters`);
    await page.getByRole('row', { name: 'heat exchange, envelope to room air alpha_e' }).waitFor();
    const check = page.getByRole('button', { name: 'Beats persistence', exact: true });
    await check.waitFor();
    const text = await page.locator('main').innerText();
    const codes = text.match(/\b(PT\d+H|G\d+ [a-z]+|at_bound|non_identifiable|free_run)\b/g);
    holds(codes === null, `codes are shown raw: ${codes}`);
    await systemLine(page, base, 'room/5');
    await check.hover();
    await page.getByRole('tooltip').filter({ hasText: 'G4 beats persistence' }).waitFor();
  });
}
