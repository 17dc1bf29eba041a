// A service that wants a token: the page asks for it once, and works from then on.
import { execFileSync } from 'node:child_process';
import { bare, holds, test } from './harness.js';

/** A service with one system and one token: `{base, token, revoke, stop}`. */
async function guarded(binary) {
  const verb = (database, ...words) => execFileSync(binary, ['token', ...words, '--database', database], { encoding: 'utf8' });
  let token;
  const service = await bare(binary, database => {
    ({ token } = JSON.parse(verb(database, 'create', '--name', 'page', '--scope', 'admin', '--json')));
  });
  const made = await fetch(`${service.base}/systems/room/4`, {
    method: 'PUT',
    headers: { authorization: `Bearer ${token}`, 'content-type': 'application/json' },
    body: '{"label":"Kitchen","model":"rc2"}',
  });
  holds(made.status === 201, `the system was not made: ${made.status}`);
  return { ...service, token, revoke: () => verb(service.database, 'revoke', 'page') };
}

export async function tokens(chrome, binary) {
  const service = await guarded(binary);
  try {
    await test(chrome, 'the_page_asks_for_a_token_once_and_then_works', {}, async page => {
      await page.goto(`${service.base}/ui/`);
      const dialog = page.getByRole('dialog', { name: 'This service wants a token' });
      await dialog.waitFor();
      holds((await page.getByRole('dialog').count()) === 1, 'all refused requests ask one question');
      // From the keyboard: the field has the focus.
      await page.keyboard.type('lampyris_wrong');
      await page.keyboard.press('Enter');
      await dialog.getByText('It was refused: nobody knows this token.').waitFor();
      await page.keyboard.type(service.token);
      await page.keyboard.press('Enter');
      await page.getByText('Kitchen').first().waitFor();
      await page.locator('header .status', { hasText: 'live' }).waitFor();
      holds((await dialog.count()) === 0, 'the question stays');
      await page.reload();
      await page.getByText('Kitchen').first().waitFor();
      holds((await dialog.count()) === 0, 'the tab has forgotten its token');
      holds(!page.url().includes('lampyris_'), 'the token is in the address');
    });
    await test(chrome, 'a_question_that_is_left_comes_back_on_demand_only', {}, async page => {
      // One answer is still on its way when the question is left: it must not bring it back.
      let release;
      const released = new Promise(done => (release = done));
      await page.route(/\/schedules\?/, async route => {
        await released;
        await route.continue();
      });
      await page.goto(`${service.base}/ui/`);
      const dialog = page.getByRole('dialog', { name: 'This service wants a token' });
      await dialog.waitFor();
      await page.keyboard.press('Escape');
      await page.getByRole('alert').getByText('A token is needed').waitFor();
      release();
      await page.waitForTimeout(1500);
      holds((await dialog.count()) === 0, 'the stream or a late answer brings the question back');
      await page.getByRole('button', { name: 'Try again' }).click();
      await dialog.waitFor();
      await page.keyboard.type(service.token);
      await page.keyboard.press('Enter');
      await page.getByText('Kitchen').first().waitFor();
    });
    await test(chrome, 'a_token_that_ends_is_asked_for_anew', {}, async page => {
      await page.addInitScript(token => sessionStorage.setItem('lampyris-token', token), service.token);
      await page.goto(`${service.base}/ui/`);
      await page.locator('header .status', { hasText: 'live' }).waitFor();
      service.revoke();
      const dialog = page.getByRole('dialog', { name: 'This service wants a token' });
      await dialog.getByText('It was refused: the token was revoked.').waitFor();
    });
  } finally {
    await service.stop();
  }
}
