// What happens when things are not as they should be: bad files, bad documents, lost connections, no mouse.
import { readFileSync } from 'node:fs';
import { ask, holds, test, wire } from './harness.js';

const rows = count =>
  Array.from(
    { length: count },
    (_, at) =>
      `${new Date(Date.UTC(2026, 0, 5) + at * 1_800_000).toISOString().slice(0, 19)}Z;${(20 + Math.sin(at / 8)).toFixed(2)};${(3 + Math.cos(at / 8)).toFixed(2)};7`,
  );

/** A job that runs until it is stopped. */
const endless = {
  kind: 'estimate',
  system: 'room/1',
  experiment: true,
  method: { name: 'cfa_thesis', seed: 1 },
  budget: { evaluations: 100_000_000 },
};

export async function edges(chrome, { base, port }) {
  await test(chrome, 'a_file_is_uploaded_with_its_columns_mapped_and_bad_rows_shown', {}, async page => {
    await page.goto(`${base}/ui/new`);
    await page.getByLabel('Name: its kind and a number or word').fill('room/9');
    await page.getByLabel('What people call it').fill('Attic');
    await page.getByRole('button', { name: 'Add it and upload measurements' }).click();
    await page.getByText('No measurements yet').waitFor();
    const lines = rows(60);
    lines[3] = lines[3].replace(/^[^;]*/, 'yesterday');
    const text = ['time;Raumtemperatur;T_out[degC];comment', ...lines].join('\n');
    await page.getByLabel('CSV file').setInputFiles({ name: 'attic.csv', mimeType: 'text/csv', buffer: Buffer.from(text) });
    await page.getByLabel('Channel of Raumtemperatur').fill('T_room');
    await page.getByLabel('Unit of Raumtemperatur').selectOption('degC');
    holds(!(await page.getByLabel('Use comment').isChecked()), 'what has no meaning is taken');
    await page.getByRole('button', { name: 'Upload 2 channels' }).click();
    await page.getByText(/rows from .* are taken as win_/).waitFor();
    const [taken] = (await ask(base, '/systems/room/9/windows')).items;
    holds(Object.keys(taken.channels).sort().join() === 'T_out,T_room', Object.keys(taken.channels).join());
    holds(taken.rejected_rows.length === 1, `${taken.rejected_rows.length} rows are refused`);
    await page.getByText(taken.rejected_rows[0].reason, { exact: false }).first().waitFor();
    await page.locator('.strips canvas').first().waitFor();
    // A file that is none: every fault is said, and nothing is lost.
    await page
      .getByLabel('CSV file')
      .setInputFiles({ name: 'bad.csv', mimeType: 'text/csv', buffer: Buffer.from('time,T_room[furlong]\n2026-01-05T00:00:00Z,21') });
    await page.getByLabel('Use T_room[furlong]').check();
    await page.getByRole('button', { name: 'Upload 1 channel' }).click();
    await page
      .getByRole('alert')
      .getByText(/furlong/)
      .first()
      .waitFor();
  });

  await test(chrome, 'measurements_are_kept_out_of_training_with_a_reason', {}, async page => {
    await page.goto(`${base}/ui/systems/room/9/data`);
    await page.getByLabel('From (UTC)').fill('2026-01-05T02:00');
    await page.getByLabel('To (UTC)').fill('2026-01-05T01:00');
    await page.getByText('It ends before it begins').waitFor();
    await page.getByLabel('To (UTC)').fill('2026-01-05T04:00');
    await page.getByLabel('Reason').fill('windows were open');
    await page.getByRole('button', { name: 'Keep it out' }).click();
    await page.getByRole('cell', { name: 'windows were open' }).waitFor();
    const [kept] = (await ask(base, '/systems/room/9')).exclude;
    holds(kept.reason === 'windows were open' && kept.from === '2026-01-05T02:00:00Z' && kept.to === '2026-01-05T04:00:00Z', JSON.stringify(kept));
    await page.getByRole('button', { name: 'Use it again' }).click();
    await page.getByText('every measurement is used').waitFor();
    // On the clock of the system: an hour that comes twice in autumn is asked about, one that never comes is refused.
    await ask(base, '/systems/room/9', { ...(await ask(base, '/systems/room/9')), system: undefined, location: { zone: 'Europe/Copenhagen' } }, 'PUT');
    await page.reload();
    await page.getByLabel('From (Europe/Copenhagen)').fill('2026-10-25T02:30');
    await page.getByLabel('The clock shows it twice').selectOption({ label: 'after it is set back, UTC+1' });
    await page.getByLabel('To (Europe/Copenhagen)').fill('2026-03-29T02:30');
    await page.getByText('it never comes').waitFor();
    await page.getByLabel('To (Europe/Copenhagen)').fill('2026-10-25T04:00');
    await page.getByLabel('Reason').fill('guests');
    await page.getByRole('button', { name: 'Keep it out' }).click();
    await page.getByRole('cell', { name: 'guests' }).waitFor();
    const [autumn] = (await ask(base, '/systems/room/9')).exclude;
    holds(autumn.from === '2026-10-25T01:30:00Z' && autumn.to === '2026-10-25T03:00:00Z', JSON.stringify(autumn));
    await page.getByRole('button', { name: 'Use it again' }).click();
    await page.getByText('every measurement is used').waitFor();
  });

  await test(chrome, 'a_policy_is_changed_and_a_bad_one_is_refused_at_its_field', {}, async page => {
    await page.goto(`${base}/ui/systems/room/9/settings`);
    const length = page.getByLabel('Stale after', { exact: true });
    const unit = page.getByLabel('Unit: Stale after');
    await unit.selectOption('as ISO 8601');
    await length.fill('three days');
    await page.getByRole('button', { name: 'Save' }).click();
    await page.getByRole('alert').getByText('/policy/stale_after').waitFor();
    await length.fill('P5D');
    await unit.selectOption('days');
    await page.getByLabel('What happens to a new fit').selectOption('suggest');
    // A zone stands alone, and a place goes with it.
    await page.getByLabel('Time zone').fill('Europe/Brussels');
    await page.getByRole('button', { name: 'Save' }).click();
    await page.getByText('room/9 is changed').first().waitFor();
    holds(JSON.stringify((await ask(base, '/systems/room/9')).location) === '{"zone":"Europe/Brussels"}', 'the zone is not kept');
    await length.fill('4');
    await page.getByLabel('Latitude').fill('55.7');
    await page.getByLabel('Longitude').fill('12.6');
    await page.getByLabel('Time zone').fill('Europe/Copenhagen');
    const saved = page.waitForResponse(response => response.request().method() === 'PUT' && response.ok());
    await page.getByRole('button', { name: 'Save' }).click();
    await saved;
    await page.getByText('room/9 is changed').first().waitFor();
    const { policy, location } = await ask(base, '/systems/room/9');
    holds(policy.mode === 'suggest' && policy.stale_after === 'P4D', JSON.stringify(policy));
    holds(location.lat === 55.7 && location.zone === 'Europe/Copenhagen', JSON.stringify(location));
  });

  await test(chrome, 'faults_of_a_model_stand_at_their_lines', {}, async page => {
    await page.goto(`${base}/ui/edit/model`);
    await page.getByText('No faults').waitFor();
    const field = page.getByLabel('Document, JSON');
    const good = await field.inputValue();
    const bad = good.replace('alpha*(T_out - T_r)', 'alfa*(T_out - T_r)').replace('"unit": "1/h"', '"unit": "furlong"');
    await field.fill(bad);
    const faults = page.locator('.faults li');
    await page.locator('.status', { hasText: '2 faults' }).waitFor();
    const lineOf = text => bad.split('\n').findIndex(line => line.includes(text)) + 1;
    holds((await faults.nth(0).innerText()).startsWith(`line ${lineOf('furlong')} `), await faults.nth(0).innerText());
    holds((await faults.nth(1).innerText()).startsWith(`line ${lineOf('alfa')} `), await faults.nth(1).innerText());
    holds((await faults.nth(1).innerText()).includes('did you mean `alpha`'), 'nothing is suggested');
    holds((await page.locator('.editor pre .fault').count()) === 2, 'the lines have no mark');
    await page.getByRole('button', { name: /Save as a new model/ }).isDisabled();
    // A comma is missing at the end of its line, not where the next one begins.
    await field.fill(good.replace('"unit": "1/h",', '"unit": "1/h"'));
    await page.locator('.faults li', { hasText: /a `,` or `}` is missing/ }).waitFor();
    const comma = good.split('\n').findIndex(line => line.includes('"1/h"')) + 1;
    holds((await faults.nth(0).innerText()).startsWith(`line ${comma} `), await faults.nth(0).innerText());
    await field.fill(good.replace('my_room', 'browser_room'));
    await page.getByText('No faults').waitFor();
    await field.press('Control+s');
    await page.waitForURL('**/ui/models/browser_room');
    await page.locator('.equation', { hasText: 'alpha*(T_out - T_r)' }).waitFor();
    // A new one is compared with the model that it was made from, which keeps its effects; a room begins with its own.
    await page.goto(`${base}/ui/edit/model?from=room3%2Bmetered_gain:P_appliances`);
    await page.getByText('It says the same as').waitFor();
    holds((await field.inputValue()).includes('"metered_gain:P_appliances"'), 'the effect is lost');
    await field.fill((await field.inputValue()).replace('"room3"', '"room2"'));
    await page.getByRole('row', { name: 'base room3 room2' }).waitFor();
    await page.goto(`${base}/ui/edit/effect?system=room/5`);
    holds((await page.getByLabel('added to').inputValue()) === 'tite', 'another model than that of the room');
  });

  await test(chrome, 'a_job_is_watched_live_and_cancelled', {}, async page => {
    const { id } = await ask(base, '/jobs', endless);
    await page.goto(`${base}/ui/jobs/${id}`);
    const evaluations = () =>
      page
        .locator('dl.figures div', { hasText: /^evaluations/ })
        .locator('dd')
        .innerText();
    await page.getByText('generation').first().waitFor();
    const before = parseInt(await evaluations(), 10);
    await page.waitForFunction(from => parseInt(document.querySelector('dl.figures dd').innerText, 10) > from, before);
    // A line that has not fallen yet is flat, and no box.
    await page.locator('svg.chart path').first().waitFor({ state: 'attached' });
    await page.getByRole('button', { name: 'Stop' }).click();
    await page.locator('.card .status', { hasText: 'cancelled' }).first().waitFor();
    holds((await ask(base, `/jobs/${id}`)).state === 'cancelled', 'it runs on');
  });

  await test(chrome, 'a_lost_connection_is_said_and_mends_itself', {}, async page => {
    const line = await wire(port);
    try {
      await page.goto(`${line.base}/ui/jobs`);
      const live = page.locator('header .status', { hasText: 'live' });
      await live.waitFor();
      line.cut();
      await page.getByText('connection lost, trying again').waitFor();
      const { id } = await ask(base, '/jobs', { kind: 'estimate', system: 'room/3', experiment: true });
      line.mend();
      await live.waitFor();
      // What happened meanwhile is told.
      await page.getByRole('link', { name: id.slice(0, 12) }).waitFor();
      await page
        .locator('tr', { hasText: id.slice(0, 12) })
        .getByText('succeeded')
        .waitFor();
    } finally {
      line.close();
    }
  });

  await test(chrome, 'zoom_survives_a_live_update', {}, async page => {
    await page.goto(`${base}/ui/systems/room/5?with=none`);
    const canvas = page.locator('.strips .u-over').first();
    await canvas.waitFor();
    const box = await canvas.boundingBox();
    await page.mouse.move(box.x + box.width * 0.3, box.y + 50);
    await page.mouse.down();
    await page.mouse.move(box.x + box.width * 0.5, box.y + 60, { steps: 5 });
    await page.mouse.up();
    await page.waitForURL(/from=/);
    const zoomed = page.url();
    const { id } = await ask(base, '/jobs', { kind: 'estimate', system: 'room/5', experiment: true });
    await page
      .getByText(/estimate of room\/5:/)
      .first()
      .waitFor();
    holds((await ask(base, `/jobs/${id}`)).state === 'succeeded', 'the job failed');
    await page.waitForTimeout(500);
    holds(page.url() === zoomed, `${page.url()} beside ${zoomed}`);
    // The chart shows what the address says, also after a reload, and the whole again when asked.
    await page.reload();
    await page.getByRole('button', { name: 'Whole range' }).click();
    holds(!page.url().includes('from='), page.url());
  });

  await test(chrome, 'a_thinned_chart_says_so_and_shows_every_sample_when_zoomed', {}, async page => {
    await page.goto(`${base}/ui/systems/room/3`);
    await page.getByText(/Thinned: one point of the chart stands for \d+ of/).waitFor();
    const asked = page.waitForResponse(answer => answer.url().includes('/comparison') && answer.url().includes('from='));
    for (let times = 0; times < 3; times += 1) await page.getByRole('button', { name: 'Zoom in' }).click();
    await asked;
    await page.getByText(/Every one of the \d+ samples is shown/).waitFor();
  });

  await test(chrome, 'a_chart_gives_its_numbers_as_a_table_csv_and_curl', {}, async page => {
    await page.goto(`${base}/ui/systems/room/5`);
    const frame = page.locator('figure.frame', { hasText: 'Measured and model' });
    await frame.getByRole('button', { name: 'Table' }).click();
    await frame.getByRole('columnheader', { name: 'T_room measured' }).waitFor();
    await frame.getByRole('button', { name: 'curl' }).click();
    const command = await frame.locator('.command code').innerText();
    holds(/^curl -s '.*\/fits\/fit_.*\/comparison.*'$/.test(command), command);
    const answer = await fetch(command.slice(9, -1));
    holds(answer.ok, 'the command asks for nothing');
    const saving = page.waitForEvent('download');
    await frame.getByRole('button', { name: 'CSV' }).click();
    const text = readFileSync(await (await saving).path(), 'utf8');
    holds(text.startsWith('time,') && text.split('\n').length > 600, text.slice(0, 80));
  });

  await test(chrome, 'a_thinned_chart_gives_every_sample_as_well', {}, async page => {
    const [fit] = (await ask(base, '/fits?system=room/3&page_size=1')).items;
    const { samples } = await ask(base, `/fits/${fit.id}/comparison?max_points=2`);
    await page.goto(`${base}/ui/systems/room/3?fit=${fit.id}`);
    const rowsOf = async name => {
      const saving = page.waitForEvent('download');
      await page.getByRole('button', { name }).click();
      return readFileSync(await (await saving).path(), 'utf8').trim().split('\n').length - 1;
    };
    const [thinned, all] = [await rowsOf('CSV, thinned'), await rowsOf('CSV, all samples')];
    holds(thinned <= 2000 && all === samples && all > thinned, `${thinned} and ${all} of ${samples} samples`);
  });

  await test(chrome, 'two_fits_are_judged_on_the_same_samples_of_what_is_shown', {}, async page => {
    const [one, other] = (await ask(base, '/fits?system=room/5')).items.filter(({ metrics }) => metrics.T_room);
    const { from } = one.parts.validation;
    const to = new Date(Date.parse(from) + 3 * 86_400_000).toISOString().replace('.000Z', 'Z');
    await page.goto(`${base}/ui/systems/room/5?fit=${one.id}&with=${other.id}&from=${from}&to=${to}`);
    const table = page.getByRole('region', { name: 'Errors of this view' });
    await table.getByText('only samples that both fits have').waitFor();
    const rows = (await table.locator('tbody tr').allInnerTexts()).map(row => row.split('\t'));
    const { errors } = await ask(base, `/compare?fits=${one.id},${other.id}&from=${from}&to=${to}&max_points=1`);
    const told = errors.filter(({ horizon }) => horizon === 'free_run');
    holds(rows.length === told.length && rows.length >= 2, rows.join('\n'));
    holds(rows.every((row, at) => Number(row[2]) === told[at].n && told[at].n <= 73), rows.join('\n'));
  });

  for (const scheme of ['light', 'dark'])
    await test(chrome, `a_pressed_button_can_be_read_under_the_pointer_in_${scheme}`, { scheme }, async page => {
      await page.goto(`${base}/ui/systems/room/5`);
      const button = page.getByRole('button', { name: 'Free run', pressed: true });
      await button.hover();
      const [letters, ground] = await button.evaluate(part => [getComputedStyle(part).color, getComputedStyle(part).backgroundColor].map(
        text => text.match(/\d+/g).slice(0, 3).reduce((sum, value) => sum + Number(value), 0) / 765));
      holds(Math.abs(letters - ground) > 0.6, `${letters} on ${ground}`);
    });

  await test(chrome, 'every_chart_gives_a_picture_of_itself', {}, async page => {
    const channels = text => [1, 3, 5].map(at => parseInt(text.slice(at, at + 2), 16));
    // How far the nearest pixel is from a colour: a thin line is mixed with its ground.
    const near = (colours, wanted) =>
      Math.min(...colours.map(text => Math.max(...text.split(',').map((part, at) => Math.abs(Number(part) - channels(wanted)[at])))));
    const coloursOf = async frame => {
      const saving = page.waitForEvent('download');
      await frame.getByRole('button', { name: 'PNG' }).click();
      const file = await saving;
      const bytes = readFileSync(await file.path()).toString('base64');
      return page.evaluate(async base64 => {
        const image = new Image();
        image.src = `data:image/png;base64,${base64}`;
        await image.decode();
        const canvas = document.createElement('canvas');
        [canvas.width, canvas.height] = [image.width, image.height];
        const ctx = canvas.getContext('2d');
        ctx.drawImage(image, 0, 0);
        const { data } = ctx.getImageData(0, 0, image.width, image.height);
        const colours = new Set();
        for (let at = 0; at < data.length; at += 4) colours.add(`${data[at]},${data[at + 1]},${data[at + 2]}`);
        return { width: image.width, height: image.height, colours: [...colours] };
      }, bytes);
    };
    await page.goto(`${base}/ui/systems/room/5`);
    await page.locator('.strips canvas').first().waitFor();
    const run = await coloursOf(page.locator('figure.frame', { hasText: 'Measured and model' }));
    for (const line of ['#1b1f24', '#0072b2', '#c65200']) holds(near(run.colours, line) < 30, `${line} is not in the picture`);
    holds(run.width > 2000 && run.height > 700, `${run.width} x ${run.height}`);
    await page.goto(`${base}/ui/systems/room/5/fails`);
    await page.locator('svg.heat').waitFor();
    const map = await coloursOf(page.locator('figure.frame', { hasText: 'Error by day and hour' }));
    for (const end of ['#0072b2', '#d55e00']) holds(near(map.colours, end) < 30, `${end} is not in the map`);
  });

  await test(chrome, 'numbers_and_commands_are_a_key_away', {}, async page => {
    await page.goto(`${base}/ui/systems/room/5/fails`);
    await page.locator('svg.heat').waitFor();
    await page.keyboard.press('?');
    const keys = page.getByRole('dialog', { name: 'Keys' });
    for (const key of [/^t$/, /^\.$/]) await keys.locator('kbd', { hasText: key }).waitFor();
    await page.keyboard.press('Escape');
    // The first chart, then the one that the pointer was on last.
    await page.keyboard.press('t');
    await page.getByRole('columnheader', { name: 'day', exact: true }).waitFor();
    await page.keyboard.press('t');
    await page.getByRole('columnheader', { name: 'day', exact: true }).waitFor({ state: 'detached' });
    await page.locator('figure.frame', { hasText: 'Innovations' }).first().hover();
    await page.keyboard.press('t');
    await page.getByRole('columnheader', { name: 'autocorrelation' }).first().waitFor();
    // A page, an action and a system are found by a part of their name.
    const command = async (typed, options) => {
      await page.keyboard.press('.');
      const dialog = page.getByRole('dialog', { name: 'Commands' });
      await dialog.waitFor();
      await page.keyboard.type(typed);
      // The systems among them are asked for when the list opens.
      await page.waitForFunction(many => document.querySelectorAll('.commands [role=option]').length === many, options);
      await page.keyboard.press('Enter');
      await dialog.waitFor({ state: 'detached' });
    };
    await command('show ladder', 1);
    await page.waitForURL('**/systems/room/5/ladder');
    await command('open room/3', 1);
    await page.getByRole('heading', { level: 1, name: 'room/3' }).waitFor();
    await command('go jobs', 1);
    await page.getByRole('heading', { level: 1, name: 'Jobs' }).waitFor();
    await page.keyboard.press('.');
    await page.getByRole('dialog', { name: 'Commands' }).waitFor();
    await page.keyboard.type('no such thing');
    await page.getByText('Nothing here is called so.').waitFor();
    await page.keyboard.press('Escape');
    await page.getByRole('dialog', { name: 'Commands' }).waitFor({ state: 'detached' });
  });

  await test(chrome, 'the_keyboard_alone_leads_everywhere', {}, async page => {
    await page.goto(`${base}/ui/`);
    await page.locator('table.systems tbody tr').nth(4).waitFor();
    await page.keyboard.press('?');
    await page.getByRole('dialog', { name: 'Keys' }).waitFor();
    await page.keyboard.press('Escape');
    await page.getByRole('dialog', { name: 'Keys' }).waitFor({ state: 'detached' });
    await page.keyboard.press('j');
    await page.keyboard.press('x');
    await page.getByRole('button', { name: 'Refit 1 selected' }).waitFor();
    const system = await page.locator('tr[aria-current=true] th a').innerText();
    await page.keyboard.press('Enter');
    await page.getByRole('heading', { level: 1, name: system }).waitFor();
    await page.keyboard.press('5');
    await page.getByText('What the gate says').waitFor();
    holds(page.url().endsWith('/parameters'), page.url());
    await page.keyboard.press('1');
    await page.locator('.strips').focus();
    await page.keyboard.press('+');
    await page.waitForURL(/from=/);
    const zoomed = page.url();
    await page.keyboard.press('ArrowRight');
    await page.waitForFunction(before => location.href !== before, zoomed);
    await page.keyboard.press('z');
    await page.waitForURL(url => !url.search.includes('from='));
    await page.keyboard.press(']');
    await page.waitForFunction(name => !document.querySelector('h1')?.innerText.includes(name), system);
    await page.keyboard.press('g');
    await page.keyboard.press('j');
    await page.getByRole('heading', { level: 1, name: 'Jobs' }).waitFor();
    // A key in a field is a letter.
    await page.keyboard.press('g');
    await page.keyboard.press('o');
    await page.locator('table.systems').waitFor();
    await page.keyboard.press('/');
    await page.keyboard.type('room/3 g j');
    holds(page.url().includes('search='), page.url());
    await page.keyboard.press('Tab');
    holds(await page.evaluate(() => document.activeElement !== document.body), 'the focus is lost');
  });

  await test(chrome, 'dark_is_dark_and_is_remembered', { scheme: 'dark' }, async page => {
    await page.goto(`${base}/ui/`);
    const ground = () => page.evaluate(() => getComputedStyle(document.documentElement).backgroundColor);
    await page.getByRole('button', { name: 'Theme: as the system' }).waitFor();
    holds((await ground()) === 'rgb(13, 17, 23)', await ground());
    await page.getByRole('button', { name: 'Theme: as the system' }).click();
    holds((await ground()) === 'rgb(255, 255, 255)', await ground());
    await page.reload();
    await page.getByRole('button', { name: 'Theme: light' }).waitFor();
    holds((await ground()) === 'rgb(255, 255, 255)', await ground());
  });

  await test(chrome, 'empty_loading_and_failed_are_three_screens', {}, async page => {
    await page.goto(`${base}/ui/systems/room/404`);
    await page
      .locator('.screen.failed')
      .getByText(/room\/404/)
      .first()
      .waitFor();
    await page.goto(`${base}/ui/nothing`);
    await page.locator('.screen.empty').waitFor();
    let release = null;
    await page.route('**/systems?*', async route => {
      await new Promise(done => {
        release = done;
      });
      await route.continue();
    });
    await page.goto(`${base}/ui/`);
    await page.locator('.screen.loading').getByText('Loading the systems').waitFor();
    release();
    await page.locator('table.systems').waitFor();
    await page.unroute('**/systems?*');
    await page.route('**/systems?*', route => route.abort());
    await page.goto(`${base}/ui/`);
    await page.locator('.screen.failed').getByText('No answer from the service').waitFor();
    await page.unroute('**/systems?*');
    await page.getByRole('button', { name: 'Try again' }).click();
    await page.locator('table.systems').waitFor();
  });

  await test(chrome, 'twenty_thousand_points_in_six_strips_move', { motion: 'no-preference' }, async page => {
    await page.goto(`${base}/ui/`);
    const moved = await page.evaluate(async () => {
      const { html, render } = await import('/ui/html.js');
      const { Strips } = await import('/ui/charts/strips.js');
      const count = 20_000;
      const time = Array.from({ length: count }, (_, at) => 1.6e9 + at * 600);
      const strips = Array.from({ length: 6 }, (_, strip) => ({
        label: `strip ${strip}`,
        unit: 'K',
        height: strip ? 70 : 260,
        lines: [{ label: 'x', colour: 'model', values: time.map((_, at) => Math.sin(at / (50 + strip)) + Math.sin(at * 12.9898) * 0.3) }],
      }));
      const whole = [time[0], time.at(-1)];
      const host = document.createElement('div');
      document.body.prepend(host);
      render(
        html`<${Strips} time=${time} strips=${strips} whole=${whole} range=${[time[2000], time[14000]]} onZoom=${() => {}} label="test" />`,
        host,
      );
      await new Promise(done => setTimeout(done, 300));
      const surface = host.querySelector('.u-over').getBoundingClientRect();
      const at = x => ({ clientX: surface.left + x, clientY: surface.top + 20, shiftKey: true, bubbles: true });
      host.querySelector('.strips').dispatchEvent(new MouseEvent('mousedown', at(600)));
      const frames = 120;
      const start = performance.now();
      let drawing = 0;
      for (let frame = 0; frame < frames; frame += 1) {
        await new Promise(requestAnimationFrame);
        const begun = performance.now();
        dispatchEvent(new MouseEvent('mousemove', at(600 + 300 * Math.sin(frame / 10))));
        await Promise.resolve();
        drawing += performance.now() - begun;
      }
      const seconds = (performance.now() - start) / 1000;
      dispatchEvent(new MouseEvent('mouseup', at(600)));
      return { rate: frames / seconds, drawing: drawing / frames, plots: host.querySelectorAll('canvas').length };
    });
    console.log(
      `  20000 points in ${moved.plots} strips: ${moved.rate.toFixed(0)} frames a second, ${moved.drawing.toFixed(1)} ms of work each`,
    );
    holds(moved.plots === 6, `${moved.plots} strips`);
  });
}
