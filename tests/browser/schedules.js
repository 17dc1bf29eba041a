// Schedules: made, changed, paused and deleted, with the keyboard alone.
import { ask, holds, test } from './harness.js';

export async function schedules(chrome, { base }) {
  await test(chrome, 'a_schedule_is_made_changed_paused_and_deleted_with_the_keyboard_alone', {}, async page => {
    /** Presses Tab until something with this name has the focus. */
    const reach = async name => {
      for (let presses = 0; presses < 80; presses += 1) {
        const here = await page.evaluate(() => {
          const element = document.activeElement;
          return element.getAttribute('aria-label') ?? (element.labels?.[0] ?? element).innerText ?? '';
        });
        if (here.startsWith(name)) return;
        await page.keyboard.press('Tab');
      }
      throw new Error(`Tab does not reach ${name}`);
    };
    const write = async text => {
      await page.keyboard.press('Control+a');
      await page.keyboard.type(text);
    };
    await page.goto(`${base}/ui/schedules`);
    await page.getByRole('cell', { name: 'At 02:30.' }).waitFor();
    await reach('New schedule');
    await page.keyboard.press('Enter');
    const dialog = page.getByRole('dialog', { name: 'New schedule' });
    await dialog.getByText('At 02:30.').waitFor();
    // The first field has the focus, and every fault stands at its own.
    await page.keyboard.type('weekly');
    await reach('When');
    await write('0 25 * * 1');
    await reach('Time zone');
    await write('Mars/Olympus');
    await reach('Systems');
    await write('room');
    await reach('What is asked');
    await write('{"budget": {"evaluations": "many"}}');
    for (const [field, says] of [
      [/^When/, '`0 25 * * 1` is no cron pattern'],
      [/^Time zone/, '`Mars/Olympus` is no IANA time zone'],
      [/^Systems/, 'room'],
      [/^What is asked/, 'evaluations'],
    ]) {
      const place = dialog.locator('.field', { has: page.locator('label', { hasText: field }) });
      await place.locator('.faults', { hasText: says }).waitFor();
      holds((await place.locator('[aria-invalid=true]').count()) === 1, `${field} has no mark`);
    }
    await page.keyboard.press('Shift+Tab');
    await write('room/3, room/5');
    await page.keyboard.press('Shift+Tab');
    await write('Europe/Copenhagen');
    await page.keyboard.press('Shift+Tab');
    await write('0 5 * * 1');
    await reach('What is asked');
    await write('{"budget": {"evaluations": 400}}');
    await dialog.getByText('At 05:00, on Monday.').waitFor();
    holds((await dialog.locator('.plan div').count()) === 5, 'the next runs are not five');
    holds((await dialog.locator('.plan').innerText()).match(/05:00/g).length >= 6, 'the runs are not at five o’clock');
    holds((await dialog.locator('[aria-invalid=true]').count()) === 0, 'a fault stays');
    await reach('Make it');
    await page.keyboard.press('Enter');
    await dialog.waitFor({ state: 'detached' });
    const row = page.getByRole('row', { name: /^weekly/ });
    await row.getByText('At 05:00, on Monday.').waitFor();
    const made = await ask(base, '/schedules/weekly');
    holds(made.systems.join() === 'room/3,room/5' && made.zone === 'Europe/Copenhagen', JSON.stringify(made));
    holds(made.request.budget.evaluations === 400, JSON.stringify(made.request));

    // The focus is where it was before the form was opened.
    holds((await page.evaluate(() => document.activeElement.innerText)) === 'New schedule', 'the focus is lost');
    await reach('Edit weekly');
    await page.keyboard.press('Enter');
    const change = page.getByRole('dialog', { name: 'Schedule weekly' });
    await change.getByText('At 05:00, on Monday.').waitFor();
    await reach('When');
    await write('30 4 * * *');
    await change.getByText('At 04:30.').waitFor();
    await page.keyboard.press('Enter');
    await row.getByText('At 04:30.').waitFor();
    await reach('Pause weekly');
    await page.keyboard.press('Enter');
    await row.locator('.status', { hasText: 'paused' }).waitFor();
    const held = await ask(base, '/schedules/weekly');
    holds(held.enabled === false && held.next_runs.length === 0, JSON.stringify(held));
    await page.keyboard.press('Enter');
    await row.locator('.status', { hasText: /\son$/ }).waitFor();
    const resumed = await ask(base, '/schedules/weekly');
    holds(resumed.enabled && resumed.cron === '30 4 * * *' && resumed.request.budget.evaluations === 400, JSON.stringify(resumed));

    // Run now leads to the batch, and the way back shows when it ran.
    await reach('Run now: weekly');
    await page.keyboard.press('Enter');
    await page.waitForURL('**/ui/batches/*');
    await page.keyboard.press('g');
    await page.keyboard.press('s');
    await row.getByRole('link').waitFor();
    await reach('Delete weekly');
    await page.keyboard.press('Enter');
    await page.getByRole('dialog', { name: 'Delete weekly?' }).waitFor();
    await reach('Delete it');
    await page.keyboard.press('Enter');
    await row.waitFor({ state: 'detached' });
    holds((await ask(base, '/schedules')).items.every(entry => entry.name !== 'weekly'), 'it is still there');
    // What belongs to the service stays, and the page says why.
    await reach('Delete nightly');
    await page.keyboard.press('Enter');
    await reach('Delete it');
    await page.keyboard.press('Enter');
    await page.getByRole('alert').getByText('the nightly schedule is part of the service').waitFor();
    await page.keyboard.press('Escape');
    await page.getByRole('dialog').waitFor({ state: 'detached' });
  });
}
