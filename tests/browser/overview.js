// The overview of many systems: grouped, sorted, searched, and left and found again as it was.
import { ask, bare, fortnight, holds, test } from './harness.js';

const ROOMS = 120;

export async function overview(chrome, binary) {
  const { base, stop } = await bare(binary);
  const heads = page => page.locator('table.systems tr.group');
  const systems = page => page.locator('table.systems tbody tr:not(.group)');
  try {
    for (let at = 1; at <= ROOMS; at++)
      await ask(base, `/systems/room/${at}`, { label: `Room ${at}`, model: 'rc2', group: `House ${at % 3}/Floor ${at % 2}` }, 'PUT');
    await ask(base, '/systems/site/roof', { label: 'Weather mast' }, 'PUT');

    await test(chrome, 'equal_steps_are_one_line_that_can_be_opened', {}, async page => {
      await page.goto(`${base}/ui/`);
      const line = page.getByRole('button', { name: `${ROOMS} rooms: Nothing was estimated yet.` });
      await line.waitFor();
      holds((await systems(page).count()) === 1, 'the rooms are not one line');
      await line.click();
      await systems(page).nth(40).waitFor();
      holds(page.url().includes('open='), 'what is open is not in the address');
      // Enter on a button is that button's, and of a row it opens the system.
      await page.getByRole('button', { name: 'Compact rows' }).focus();
      await page.keyboard.press('Enter');
      await page.locator('table.compact').waitFor();
      holds(!page.url().includes('/systems/'), `Enter on a button has left the page for ${page.url()}`);
      await page.getByRole('button', { name: 'Compact rows' }).press('Enter');
      await page.getByText(`lines 1 to 50 of ${ROOMS + 2}`).first().waitFor();
    });

    await test(chrome, 'the_overview_is_found_again_as_it_was_left', {}, async page => {
      await page.goto(`${base}/ui/?sort=-system&search=room`);
      await systems(page).nth(49).waitFor();
      holds((await systems(page).first().innerText()).includes(`room/${ROOMS}`), 'it is not sorted by name, the last first');
      await page.getByRole('button', { name: 'Next page' }).first().click();
      await page.getByRole('link', { name: 'room/40', exact: true }).scrollIntoViewIfNeeded();
      await page.waitForTimeout(400);
      const [url, top] = [page.url(), await page.evaluate(() => scrollY)];
      holds(top > 100 && url.includes('page=2'), `${url} at ${top}`);
      await page.getByRole('link', { name: 'room/40', exact: true }).click();
      await page.getByRole('tab', { name: 'What is missing' }).waitFor();
      await page.goBack();
      await page.locator('tr[aria-current=true] a:focus', { hasText: 'room/40' }).waitFor();
      holds(page.url() === url, `${page.url()} is not ${url}`);
      const back = await page.evaluate(() => scrollY);
      holds(Math.abs(back - top) < 60, `it was at ${top} and is at ${back}`);
      await page.keyboard.press('k');
      await page.locator('tr[aria-current=true] a:focus', { hasText: 'room/41' }).waitFor();
    });

    await test(chrome, 'systems_are_grouped_and_a_filter_is_kept_by_name', {}, async page => {
      await page.goto(`${base}/ui/`);
      await page.getByLabel('Group by').selectOption('group');
      await heads(page).nth(6).waitFor();
      holds((await heads(page).first().innerText()).includes('House 0/Floor 0: 20 rooms'), await heads(page).first().innerText());
      await page.getByLabel('Search the systems').fill('house 1 room 7');
      await page.getByRole('link', { name: 'room/7', exact: true }).waitFor();
      await page.getByRole('button', { name: 'Save this filter' }).click();
      await page.getByLabel('Name').fill('sevens');
      await page.getByRole('button', { name: 'Save it' }).click();
      await page.getByRole('button', { name: 'Forget sevens' }).waitFor();
      await page.goto(`${base}/ui/`);
      await page.getByLabel('Saved filter').selectOption('sevens');
      await page.getByRole('link', { name: 'room/7', exact: true }).waitFor();
      holds(page.url().includes('by=group') && page.url().includes('search='), page.url());
    });

    await test(chrome, 'a_group_is_changed_in_place', {}, async page => {
      await page.goto(`${base}/ui/?search=room%2F11`);
      await page.getByLabel('Select all 11 that match').check();
      await page.getByRole('button', { name: 'Change the group of 11 selected' }).click();
      await page.getByLabel('Group', { exact: true }).fill('Annexe/');
      await page.getByRole('button', { name: 'Save', exact: true }).click();
      await page.getByRole('alert').getByText('/group').waitFor();
      await page.getByLabel('Group', { exact: true }).fill('Annexe');
      await page.getByRole('button', { name: 'Save', exact: true }).click();
      await page.getByText('11 systems: in Annexe').first().waitFor();
      const rows = (await ask(base, '/systems?page_size=500')).items.filter(row => row.group === 'Annexe');
      holds(rows.length === 11 && rows.every(row => /^room\/11/.test(row.system)), `${rows.length} are there`);
    });

    await test(chrome, 'an_end_of_a_job_makes_one_row_anew_and_no_list', {}, async page => {
      await ask(base, '/systems/room/3/windows', fortnight());
      await page.goto(`${base}/ui/?search=room%2F3&sort=system`);
      await systems(page).nth(1).waitFor();
      const asked = [];
      page.on('request', request => asked.push(new URL(request.url())));
      await page.getByRole('button', { name: 'Refit room/3', exact: true }).click();
      await page.locator('tr', { has: page.getByRole('link', { name: 'room/3', exact: true }) }).filter({ hasText: 'No fit was ever accepted' }).waitFor();
      const lists = asked.filter(({ pathname, searchParams }) => ['/params', '/fits'].includes(pathname) || (pathname === '/systems' && !searchParams.has('systems')));
      holds(lists.length === 0, `${lists.map(String)}`);
    });
  } finally {
    await stop();
  }
}
