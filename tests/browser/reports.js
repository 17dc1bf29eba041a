// Reports of the command line, opened from the disk: the page's charts without a service.
import { execFile } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';
import { promisify } from 'node:util';
import { faultsOf, cutOff } from './pages.js';
import { holds, test } from './harness.js';

const run = promisify(execFile);
/** The gate may refuse the fit; the report is there all the same. */
const REJECTED = 3;
/** A small model is enough where nothing has to be found. */
const ASKED = {
  fit: ['--model', 'room2'],
  diagnose: ['--model', 'room3', '--neighbours', '1,2'],
  ladder: ['--model', 'room2', '--max-steps', '1'],
};
/** What each report must draw beside the fit. */
const DRAWN = {
  fit: [],
  diagnose: ['article.finding .pair svg', 'figure:has-text("Heat that is missing") svg.chart rect'],
  ladder: ['svg.ladder path.mark, svg.ladder circle'],
};
const OF_A_FIT = ['.strips canvas', 'svg.heat rect.cell', 'svg.rail', 'tr:has-text("Time constants")', 'tr:has-text("T_room, free run")'];

export async function reports(chrome, binary) {
  const folder = mkdtempSync(join(tmpdir(), 'lampyris-reports-'));
  try {
    const verb = words =>
      run(binary, words, { cwd: folder }).catch(error => {
        if (error.code !== REJECTED) throw error;
      });
    await verb(['twin', '--effect', 'wind_infiltration', '--seed', '7', '--days', '14', '--step', '60', '--out', 'room.csv']);
    const kinds = Object.keys(ASKED);
    await Promise.all(kinds.map(kind => verb([kind, 'room.csv', '--report', `${kind}.html`, ...ASKED[kind]])));
    for (const scheme of ['light', 'dark']) {
      await test(chrome, `reports_open_from_the_disk_and_ask_nobody_in_${scheme}`, { scheme }, async page => {
        const faults = [];
        for (const kind of kinds) {
          const asked = [];
          const hear = request => asked.push(request.url());
          page.on('request', hear);
          const address = pathToFileURL(join(folder, `${kind}.html`)).href;
          await page.goto(address);
          for (const drawn of [...OF_A_FIT, ...DRAWN[kind]]) await page.locator(drawn).first().waitFor();
          holds((await page.locator('.screen').count()) === 0, `${kind}: ${await page.locator('.screen').allInnerTexts()}`);
          // A horizon, an episode and an effect are looked at without leaving the file.
          await page.getByRole('group', { name: 'What the model knows' }).getByRole('button', { name: '6 h ahead' }).click();
          await page.getByText('the forecast that was made 6 h before').waitFor();
          await page.getByRole('button', { name: /^Show .* in the chart/ }).first().click();
          await page.waitForURL(/#.*from=/);
          await page.getByRole('region', { name: 'Measured and model' }).getByRole('button', { name: 'Whole range' }).click();
          await page.waitForURL(url => !url.hash.includes('from='));
          holds((await page.getByRole('button', { name: /curl|Refit|Add and|\bagain\b|Pin/ }).count()) === 0, `${kind}: a button needs a service`);
          // The longest has every part of the others.
          const accessible = kind === 'diagnose' ? await faultsOf(page) : [];
          for (const fault of [...accessible, ...(await cutOff(page))]) faults.push(`${kind}: ${fault}`);
          if (process.env.BROWSER_SHOTS)
            await page.screenshot({ path: join(process.env.BROWSER_SHOTS, `report-${kind}-${scheme}.png`), fullPage: true });
          if (kind === 'diagnose') {
            await page.getByRole('link', { name: 'wind_infiltration' }).first().click();
            await page.locator('.equation ins').first().waitFor();
            await page.getByRole('link', { name: 'Back to the report' }).click();
            await page.locator('article.finding').first().waitFor();
          }
          page.off('request', hear);
          const outside = asked.filter(url => url.split('#')[0] !== address && !/^(data|blob):/.test(url));
          holds(outside.length === 0, `${kind} asks for ${outside}`);
        }
        holds(faults.length === 0, `${faults.length} faults\n  ${faults.join('\n  ')}`);
      });
    }
  } finally {
    rmSync(folder, { recursive: true, force: true });
  }
}
