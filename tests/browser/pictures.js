// The pictures of the README: the demo's own rooms, as anybody sees them who starts it.
import { mkdirSync, statSync } from 'node:fs';
import { join } from 'node:path';
import { holds, test } from './harness.js';

/** All of them together: they are fetched with every clone. */
const MOST_BYTES = 600_000;
/** A room of the demo that hides two effects. */
const ROOM = '/systems/room/7';
const shots = [
  { name: 'overview', path: '/', width: 1366, height: 600, ready: 'table.systems tbody tr:nth-child(9)' },
  { name: 'fails', path: `${ROOM}/fails`, height: 870, ready: 'svg.heat rect.cell' },
  { name: 'missing', path: `${ROOM}/missing`, height: 676, scheme: 'dark', from: '.tabs', ready: 'article.finding:nth-of-type(2)' },
  { name: 'ladder', path: `${ROOM}/ladder`, height: 640, from: '.tabs', ready: 'svg.ladder' },
];

export async function pictures(chrome, { base }, folder) {
  mkdirSync(folder, { recursive: true });
  let bytes = 0;
  for (const { name, path, width = 1200, height, scheme = 'light', from, ready } of shots) {
    await test(chrome, `the_picture_${name}_is_made`, { width, height: 1000, scheme }, async page => {
      await page.goto(`${base}/ui${path}`);
      await page.locator(ready).first().waitFor();
      await page.locator('header .status', { hasText: 'live' }).waitFor();
      await page.mouse.move(0, 0);
      const top = from ? (await page.locator(from).boundingBox()).y - 8 : 0;
      const file = join(folder, `${name}.png`);
      await page.screenshot({ path: file, clip: { x: 0, y: top, width, height }, fullPage: true });
      bytes += statSync(file).size;
    });
  }
  console.log(`  ${bytes} bytes`);
  holds(bytes < MOST_BYTES, `${bytes} bytes of pictures`);
}
