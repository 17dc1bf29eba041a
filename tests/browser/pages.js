// Every page in light and dark, narrow and wide: no serious fault of accessibility, nothing cut off.
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { ask, holds, test } from './harness.js';

const axe = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8');

export async function faultsOf(page) {
  // The policy of the page lets no foreign script in; the tester's way in lies beside it.
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => window.axe.run(document, { resultTypes: ['violations'] }));
  return violations
    .filter(fault => ['serious', 'critical'].includes(fault.impact))
    .map(
      fault =>
        `${fault.id}: ${fault.help}\n    ${fault.nodes
          .slice(0, 3)
          .map(node => `${node.html.slice(0, 160)} ${node.failureSummary?.split('\n')[1] ?? ''}`)
          .join('\n    ')}`,
    );
}

/** Letters that leave their box, and parts that push the page wider than the window. */
export const cutOff = page =>
  page.evaluate(() => {
    const found = [];
    if (document.documentElement.scrollWidth > innerWidth + 1) {
      const wide = [...document.querySelectorAll('main *')]
        .filter(
          part => part.getBoundingClientRect().right > innerWidth + 1 && !part.closest('.scroll, svg, .uplot, .equation, .formula, .editor, pre'),
        )
        .slice(0, 3);
      found.push(
        `the page is ${document.documentElement.scrollWidth} wide in ${innerWidth}: ${wide.map(part => part.outerHTML.slice(0, 120)).join(' | ')}`,
      );
    }
    for (const button of document.querySelectorAll('main button, main a.button')) {
      if (button.scrollWidth > button.clientWidth + 2) found.push(`cut off: ${button.innerText}`);
    }
    if (/undefined|\[object|NaN|Invalid Date/.test(document.querySelector('main').innerText))
      found.push(
        `a placeholder: ${/.{0,40}(undefined|\[object|NaN|Invalid Date).{0,40}/.exec(document.querySelector('main').innerText)[0]}`,
      );
    return found;
  });

export async function pages(chrome, { base }) {
  await test(chrome, 'the_page_is_less_than_200_kB_as_it_is_sent', {}, async page => {
    const sizes = [];
    page.on(
      'requestfinished',
      request => request.url().startsWith(`${base}/ui/`) && sizes.push(request.sizes().then(size => size.responseBodySize)),
    );
    await page.goto(`${base}/ui/`);
    await page.locator('table.systems').waitFor();
    const bytes = (await Promise.all(sizes)).reduce((sum, size) => sum + size, 0);
    console.log(`  ${sizes.length} files, ${bytes} bytes`);
    holds(sizes.length > 30 && bytes < 200_000, `${sizes.length} files, ${bytes} bytes`);
  });

  const [job] = (await ask(base, '/jobs?kind=estimate&page_size=1')).items;
  const batch = await ask(base, '/jobs', { kind: 'recalibrate', systems: ['room/1', 'room/4'] });
  const [night] = (await ask(base, '/nights?page_size=1')).items;
  const places = {
    overview: ['/', 'table.systems tbody tr'],
    fit: ['/systems/room/5', '.strips canvas'],
    plant: ['/systems/plant/north', '.strips canvas'],
    'plant-output': ['/systems/plant/north?output=X_S_e', '.strips canvas'],
    'plant-fails': ['/systems/plant/north/fails?output=S_NH_e', 'svg.heat'],
    'plant-parameters': ['/systems/plant/north/parameters', 'svg.rail'],
    'plant-data': ['/systems/plant/north/data', '.strips canvas'],
    'fit-ahead': ['/systems/room/3?mode=PT6H', '.strips canvas'],
    fails: ['/systems/room/5/fails', 'svg.heat'],
    missing: ['/systems/room/7/missing', '.verdict'],
    'missing-unnamed': ['/systems/room/5/missing', '.verdict'],
    'missing-nothing': ['/systems/room/8/missing', '.verdict'],
    ladder: ['/systems/room/7/ladder', 'svg.ladder'],
    parameters: ['/systems/room/1/parameters', 'svg.rail'],
    rejected: ['/systems/room/2/parameters', 'svg.rail'],
    data: ['/systems/room/1/data', '.strips canvas'],
    settings: ['/systems/room/1/settings', 'form'],
    empty: ['/systems/room/9', '.screen.empty'],
    jobs: ['/jobs', 'tbody tr'],
    job: [`/jobs/${job.id}`, '.card'],
    batch: [`/batches/${batch.id}`, 'tbody tr'],
    models: ['/models', 'tbody tr'],
    model: ['/models/room3%2Bmetered_gain:P_appliances', '.strips canvas'],
    effect: ['/effects/wind_infiltration', '.equation'],
    'edit-model': ['/edit/model', '.strips canvas'],
    'edit-effect': ['/edit/effect?model=tite&system=room/5', '.strips canvas'],
    schedules: ['/schedules', 'tbody tr'],
    audit: ['/audit', 'tbody tr'],
    neighbours: ['/neighbours?system=room/1', 'figure.frame tbody tr'],
    'neighbours-none': ['/neighbours?system=room/5', '.screen.empty'],
    new: ['/new', 'form'],
    building: ['/building', '.matrix tbody tr'],
    'building-group': ['/building?group=room&effect=sensor_lag', '.matrix tbody tr'],
    mornings: ['/mornings', 'tbody tr'],
    morning: [`/mornings/${night.night}`, 'ol.next, .verdict'],
  };
  /** What some checks find on a page as it stands. */
  const look = async (page, name, checks) => {
    const faults = [];
    for (const check of checks) for (const fault of await check(page)) faults.push(`${name}: ${fault}`);
    if (process.env.BROWSER_SHOTS) await page.screenshot({ path: join(process.env.BROWSER_SHOTS, `${name}.png`), fullPage: true });
    return faults;
  };
  const walk = (title, width, looks) =>
    test(chrome, title, { width }, async page => {
      const faults = [];
      for (const [name, [path, ready]] of Object.entries(places)) {
        await page.goto(`${base}/ui${path}`);
        await page.locator(ready).first().waitFor();
        faults.push(...(await looks(page, name)));
      }
      holds(faults.length === 0, `${faults.length} faults\n  ${faults.join('\n  ')}`);
    });
  // To open a page takes longest, so it is looked at in three ways. 683 is 200 % of a window 1366 wide.
  await walk('no_page_has_a_serious_fault_in_light_or_dark_or_half_as_wide', 1366, async (page, name) => {
    await page.waitForLoadState('networkidle', { timeout: 1500 }).catch(() => {});
    const faults = [];
    for (const scheme of ['light', 'dark']) {
      await page.emulateMedia({ colorScheme: scheme });
      faults.push(...(await look(page, `${name}-${scheme}`, [faultsOf, cutOff])));
    }
    await page.emulateMedia({ colorScheme: 'light' });
    await page.setViewportSize({ width: 683, height: 768 });
    await page.waitForTimeout(200);
    faults.push(...(await look(page, `${name}-683`, [cutOff])));
    await page.setViewportSize({ width: 1366, height: 768 });
    return faults;
  });
  await walk('nothing_is_cut_off_on_a_telephone', 390, async (page, name) => {
    await page.waitForTimeout(200);
    return look(page, `${name}-390`, [cutOff]);
  });
}
