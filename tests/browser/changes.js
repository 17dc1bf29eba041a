// Two who change one system: nobody's change is overwritten unseen, and nothing of a form is lost.
import { ask, bare, fortnight, holds, test } from './harness.js';
import { cutOff, faultsOf } from './pages.js';

/** Somebody else, beside the page. */
async function other(base, system, change) {
  const { system: _, ...document } = await ask(base, `/systems/${system}`);
  await ask(base, `/systems/${system}`, { ...document, ...change }, 'PUT');
}

export async function changes(chrome, binary) {
  const { base, stop } = await bare(binary);
  try {
    await ask(base, '/systems/room/4', { label: 'Kitchen', model: 'rc2' }, 'PUT');

    await test(chrome, 'adding_a_system_of_an_existing_name_changes_nothing_of_it', {}, async page => {
      const before = await ask(base, '/systems/room/4');
      await page.goto(`${base}/ui/new`);
      const name = page.getByLabel('Name: its kind and a number or word');
      await name.fill('room/4');
      await page.getByLabel('What people call it').fill('Attic');
      await page.getByRole('button', { name: 'Add it and upload measurements' }).click();
      await page.getByRole('alert').getByText('There is a system room/4 already').waitFor();
      const after = await ask(base, '/systems/room/4');
      holds(JSON.stringify(after) === JSON.stringify(before), JSON.stringify(after));
      holds((await page.getByLabel('What people call it').inputValue()) === 'Attic', 'the form is lost');
      await name.fill('room/5');
      await page.getByRole('button', { name: 'Add it and upload measurements' }).click();
      await page.getByText('No measurements yet').waitFor();
      holds((await ask(base, '/systems/room/5')).label === 'Attic', 'it is not made');
    });

    await test(chrome, 'a_settings_form_that_is_older_than_a_change_is_refused_and_takes_it_over', {}, async page => {
      await page.goto(`${base}/ui/systems/room/4/settings`);
      const label = page.getByLabel('What people call it');
      const save = () => page.getByRole('button', { name: 'Save' }).click();
      await label.fill('Scullery');
      await other(base, 'room/4', { policy: { mode: 'observe' }, neighbours: ['room/5'] });
      // The page reads everything anew after a break; what the form began as is still the older document.
      const read = page.waitForResponse(`${base}/systems/room/4`);
      await page.evaluate(() => dispatchEvent(new Event('lampyris-again')));
      await read;
      await save();
      await page.getByRole('alert').getByText('Somebody has changed room/4 since this form was opened').waitFor();
      const theirs = await ask(base, '/systems/room/4');
      holds(theirs.label === 'Kitchen' && theirs.policy.mode === 'observe', JSON.stringify(theirs));
      holds((await label.inputValue()) === 'Scullery', 'what was written is lost');
      await page.getByRole('button', { name: 'Take over what has changed' }).click();
      await page.getByRole('status').getByText('taken over where you had changed nothing: neighbours, policy/mode').waitFor();
      holds((await label.inputValue()) === 'Scullery', 'what was written is lost as the change is taken over');
      await save();
      await page.getByText('room/4 is changed').first().waitFor();
      const both = await ask(base, '/systems/room/4');
      holds(both.label === 'Scullery' && both.policy.mode === 'observe' && both.neighbours.join() === 'room/5', JSON.stringify(both));
      // The next change begins from what the last one was answered with.
      await label.fill('Larder');
      await save();
      await page.waitForFunction(() => document.querySelector('main p .quiet, main .row .quiet')?.innerText === 'Larder');
      holds((await ask(base, '/systems/room/4')).label === 'Larder', 'the second save is lost');
    });

    await ask(base, '/systems/room/4/windows', fortnight(0));
    await ask(base, '/systems/room/5/windows', fortnight(3));

    await test(chrome, 'an_exclusion_that_is_older_than_a_change_is_refused_and_stays_written', {}, async page => {
      await page.goto(`${base}/ui/systems/room/4/data`);
      await page.getByLabel('From (UTC)').fill('2026-01-06T00:00');
      await page.getByLabel('To (UTC)').fill('2026-01-07T00:00');
      await page.getByLabel('Reason').fill('guests');
      await other(base, 'room/4', { label: 'Pantry' });
      const keep = page.getByRole('button', { name: 'Keep it out' });
      await keep.click();
      await page.getByRole('alert').getByText('Somebody has changed room/4').waitFor();
      holds((await ask(base, '/systems/room/4')).exclude.length === 0, 'it went through');
      const read = page.waitForResponse(`${base}/systems/room/4`);
      await page.getByRole('button', { name: 'See what is there now' }).click();
      await read;
      await page.getByText('Pantry').waitFor();
      await keep.click();
      await page.getByRole('cell', { name: 'guests' }).waitFor();
      const kept = await ask(base, '/systems/room/4');
      holds(kept.label === 'Pantry' && kept.exclude[0].reason === 'guests', JSON.stringify(kept));
    });

    await test(chrome, 'a_proposed_neighbour_is_taken_over_by_one_press_of_a_key', {}, async page => {
      await page.goto(`${base}/ui/systems/room/5/settings`);
      await page.getByRole('link', { name: 'See which rooms look like neighbours' }).click();
      await page.getByText('Nothing is stored or bound').waitFor();
      const row = page.getByRole('row', { name: /^room\/5/ });
      await page.getByRole('row', { name: /^room\/4/ }).first().getByText('yes').waitFor();
      const faults = [...(await faultsOf(page)), ...(await cutOff(page))];
      holds(faults.length === 0, faults.join('\n  '));
      const press = row.getByRole('button', { name: 'Add room/4 to the neighbours of room/5' });
      await other(base, 'room/5', { label: 'Loft' });
      await press.focus();
      await page.keyboard.press('Enter');
      await page.getByRole('alert').getByText('Somebody has changed room/5').waitFor();
      holds((await ask(base, '/systems/room/5')).neighbours.length === 0, 'it went through');
      await page.getByRole('button', { name: 'See what is there now' }).click();
      await page.getByRole('alert').waitFor({ state: 'detached' });
      await press.focus();
      await page.keyboard.press('Enter');
      await row.getByText('yes').waitFor();
      const taken = await ask(base, '/systems/room/5');
      holds(taken.neighbours.join() === 'room/4' && taken.label === 'Loft', JSON.stringify(taken));
      await page.getByRole('button', { name: 'curl' }).click();
      await page.getByText(/--data-binary '@temperatures.csv' .*\/systems\/layout'/).waitFor();
      await ask(base, '/systems/room/6', { model: 'rc2' }, 'PUT');
      await page.goto(`${base}/ui/neighbours?system=room/6`);
      await page.getByText('room/6 has no measurements yet').waitFor();
    });

    await test(chrome, 'the_page_tells_who_did_what_to_which_system', {}, async page => {
      await page.goto(`${base}/ui/`);
      await page.locator('table.systems').waitFor();
      await page.keyboard.press('g');
      await page.keyboard.press('a');
      await page.getByRole('heading', { name: 'Who did what' }).waitFor();
      await page.getByRole('cell', { name: 'put system' }).first().waitFor();
      const count = () => page.locator('tbody tr').count();
      const all = (await ask(base, '/audit')).items;
      holds((await count()) === all.length, `${await count()} of ${all.length} entries`);
      await page.getByLabel('System').fill('room/5');
      await page.keyboard.press('Enter');
      const own = all.filter(deed => deed.system === 'room/5').length;
      await page.waitForFunction(most => document.querySelectorAll('tbody tr').length === most, own);
      holds(own < all.length && page.url().endsWith('?system=room%2F5'), page.url());
      // Three screens: nothing, a fault, and page after page.
      await page.goto(`${base}/ui/audit?system=room/77`);
      await page.getByText('Nothing was done to room/77').waitFor();
      await page.goto(`${base}/ui/audit?system=nonsense`);
      await page.getByRole('alert').getByText('nonsense', { exact: false }).first().waitFor();
      const deed = subject => ({ at: '2026-03-07T08:12:44.031Z', who: 'night', action: 'promote_fit', system: 'room/4', subject, reason: 'looks right' });
      await page.route(/\/audit\?/, route => {
        const isOlder = new URL(route.request().url()).searchParams.get('page_token') === '7';
        return route.fulfill({ json: isOlder ? { items: [deed('fit_1')], next_page_token: null } : { items: [deed('fit_2')], next_page_token: '7' } });
      });
      await page.goto(`${base}/ui/audit`);
      await page.getByRole('row', { name: /night promote fit room\/4 fit_2 looks right/ }).waitFor();
      await page.getByRole('button', { name: 'Older' }).click();
      await page.getByRole('link', { name: 'fit_1' }).waitFor();
      holds((await page.getByRole('button', { name: 'Older' }).count()) === 0, 'the last page has one that is older');
      await page.getByRole('button', { name: 'Newest' }).click();
      await page.getByRole('link', { name: 'fit_2' }).waitFor();
    });
  } finally {
    await stop();
  }
}
