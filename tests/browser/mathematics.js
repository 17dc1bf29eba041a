// The equations as mathematics: drawn by the browser, reached with keys, and copied as LaTeX.
import { ask, holds, test } from './harness.js';

/** Holds the equations of the page against those that the service writes at a path. */
async function typeset(page, base, path, lines) {
  const region = page.getByRole('region', { name: 'The equations as mathematics' });
  await region.locator('mtr').first().waitFor();
  const rows = await region.locator('math > mtable > mtr').count();
  holds(rows === lines, `${rows} lines instead of ${lines}`);
  // Drawn, not listed: what is divided stands above that by which it is.
  const drawn = await region.locator('mfrac').first().evaluate(fraction => {
    const [above, below] = [...fraction.children].map(part => part.getBoundingClientRect());
    return above.height > 0 && above.bottom <= below.top + 1;
  });
  holds(drawn, 'the fractions are not drawn');
  await region.focus();
  holds(await region.evaluate(part => part === document.activeElement), 'the region cannot be reached with keys');
  await page.keyboard.press('Tab');
  holds((await page.evaluate(() => document.activeElement.innerText)) === 'Copy LaTeX', 'the button is not the next');
  await page.keyboard.press('Enter');
  await page.getByText('Copied').first().waitFor();
  const copied = await page.evaluate(() => navigator.clipboard.readText());
  const latex = await (await fetch(`${base}${path}?format=latex`)).text();
  holds(copied.trim() === latex.trim() && latex.includes('\\frac'), copied);
}

export async function mathematics(chrome, { base }) {
  await test(chrome, 'equations_are_typeset_beside_their_texts_and_copied_as_latex', {}, async page => {
    await page.context().grantPermissions(['clipboard-read', 'clipboard-write']);
    await page.goto(`${base}/ui/models/tite`);
    await page.locator('.equation').getByText('dT_e/dt').waitFor();
    await typeset(page, base, '/models/tite/equations', 3);
    const { fit, model } = await ask(base, '/params/room/5');
    const { states, outputs } = await ask(base, `/models/${encodeURIComponent(model)}`);
    await page.goto(`${base}/ui/systems/room/5/parameters`);
    await typeset(page, base, `/fits/${fit}/model`, states.length + outputs.length);
    // A plant has hundreds of lines, which are drawn when somebody wants them.
    await page.goto(`${base}/ui/models/bsm1`);
    const summary = page.getByText('As mathematics');
    await summary.waitFor();
    holds((await page.locator('math').count()) === 0, 'a plant is drawn unasked');
    await summary.press('Enter');
    await page.locator('math').waitFor();
  });
}
