// The queue in a crowd: what runs is above what waits, in parts that say how many there are, and a batch has a name.
import { ask, bare, fortnight, holds, test } from './harness.js';

const ROOMS = 40;

export async function queue(chrome, binary) {
  const { base, stop } = await bare(binary);
  try {
    for (let room = 1; room <= ROOMS; room += 1) {
      await ask(base, `/systems/room/${room}`, { model: 'rc1' }, 'PUT');
      // The last one has nothing to be fitted to, and is left out.
      if (room < ROOMS) await ask(base, `/systems/room/${room}/windows`, fortnight());
    }
    const endless = { name: 'cfa_thesis', seed: 1, generations: 100_000 };
    const { id } = await ask(base, '/jobs', {
      kind: 'recalibrate',
      systems: ['room/*'],
      method: endless,
      budget: { evaluations: 100_000_000 },
    });

    await test(chrome, 'what_runs_is_above_what_waits_and_a_batch_has_a_name', {}, async page => {
      const lists = [];
      page.on('response', response => /\/jobs\?/.test(response.url()) && lists.push(response.url()));
      await page.goto(`${base}/ui/jobs`);
      await page.getByRole('heading', { name: /^Waiting/ }).waitFor();
      const titles = await page.getByRole('heading', { level: 2 }).allInnerTexts();
      holds(titles[0].startsWith('Running') && titles[1].startsWith('Waiting'), titles.join());
      const { queued, running } = await ask(base, '/jobs/counts');
      await page.getByRole('button', { name: `queued ${queued}` }).waitFor();
      await page.getByRole('button', { name: `running ${running}` }).waitFor();
      const waiting = page.getByRole('table', { name: /^Waiting/ }).locator('tbody tr');
      const first = await waiting.first().getByRole('link').nth(1).innerText();
      holds((await waiting.count()) === Math.min(queued, 25), `${await waiting.count()} rows of ${queued}`);
      if (queued > 25) {
        await page.getByRole('button', { name: `Show ${queued - 25} more` }).click();
        await page.waitForFunction(many => document.querySelectorAll('.queue')[1].querySelectorAll('tbody tr').length === many, queued);
      }
      // The one whose turn it is moves up by the events alone: nothing is read for it at once.
      const before = lists.length;
      const runs = page.getByRole('table', { name: 'Running' });
      await runs.getByRole('button', { name: /^Cancel/ }).first().click();
      await runs.getByRole('link', { name: first, exact: true }).waitFor();
      await page.getByRole('table', { name: /^Ended/ }).getByText('cancelled').waitFor();
      holds(lists.length - before <= 1, `${lists.length - before} lists were read`);
      await page.getByRole('link', { name: new RegExp(`^Recalibration of ${ROOMS - 1} systems, `) }).click();
      await page.getByRole('heading', { level: 1, name: new RegExp(`^Recalibration of ${ROOMS - 1} systems, `) }).waitFor();
      await page.getByText(`1 of ${ROOMS - 1} have ended`).waitFor();
      await page.getByRole('table', { name: 'Left out, by reason' }).getByRole('link', { name: `room/${ROOMS}` }).waitFor();
      holds((await ask(base, `/batches/${id}`)).skipped.length === 1, 'another is left out');
    });

    await test(chrome, 'the_focus_stays_with_its_job_where_a_row_above_leaves', {}, async page => {
      await page.goto(`${base}/ui/jobs?state=queued`);
      const cancels = page.getByRole('button', { name: /^Cancel/ });
      await cancels.nth(2).waitFor();
      const names = await cancels.evaluateAll(buttons => buttons.slice(0, 3).map(button => button.getAttribute('aria-label')));
      await cancels.nth(2).focus();
      await ask(base, `/jobs/${names[1].slice('Cancel '.length)}/cancel`, undefined, 'POST');
      await page.getByRole('button', { name: names[1], exact: true }).waitFor({ state: 'detached' });
      const focused = await page.evaluate(() => document.activeElement.getAttribute('aria-label'));
      holds(focused === names[2], `the focus was at “${names[2]}” and is at “${focused}”`);
    });
  } finally {
    await stop();
  }
}
