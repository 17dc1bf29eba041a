// All browser tests, one after another, against one demo; those that need none while it fits and diagnoses its rooms.
import { browser, demo, result } from './harness.js';
import { building } from './building.js';
import { changes } from './changes.js';
import { evidence } from './evidence.js';
import { ledger } from './ledger.js';
import { story } from './story.js';
import { edges } from './edges.js';
import { foreign } from './foreign.js';
import { importing } from './import.js';
import { mathematics } from './mathematics.js';
import { morning } from './morning.js';
import { overview } from './overview.js';
import { pages } from './pages.js';
import { pictures } from './pictures.js';
import { plants } from './plants.js';
import { queue } from './queue.js';
import { reports } from './reports.js';
import { said } from './said.js';
import { schedules } from './schedules.js';
import { states } from './states.js';
import { terms } from './terms.js';
import { tokens } from './tokens.js';

const service = await demo(process.env.LAMPYRIS_BINARY);
let chrome = null;
const stop = async () => {
  await chrome?.close().catch(() => {});
  await service.stop();
};
for (const signal of ['SIGINT', 'SIGTERM', 'SIGHUP']) process.once(signal, () => stop().then(() => process.exit(1)));
try {
  chrome = await browser();
  if (process.env.BROWSER_PICTURES) {
    await service.ready();
    await pictures(chrome, service, process.env.BROWSER_PICTURES);
  } else {
    await reports(chrome, process.env.LAMPYRIS_BINARY);
    await tokens(chrome, process.env.LAMPYRIS_BINARY);
    await changes(chrome, process.env.LAMPYRIS_BINARY);
    await foreign(chrome, process.env.LAMPYRIS_BINARY);
    await importing(chrome, process.env.LAMPYRIS_BINARY);
    await queue(chrome, process.env.LAMPYRIS_BINARY);
    await overview(chrome, process.env.LAMPYRIS_BINARY);
    await morning(chrome, process.env.LAMPYRIS_BINARY);
    const begun = Date.now();
    await service.ready();
    console.log(`  the demo was waited for ${((Date.now() - begun) / 1000).toFixed(1)} s`);
    await plants(chrome, service);
    await states(chrome, service);
    await mathematics(chrome, service);
    await said(chrome, service);
    await evidence(chrome, service);
    await ledger(chrome, service);
    await story(chrome, service);
    await edges(chrome, service);
    await terms(chrome, service);
    await schedules(chrome, service);
    await pages(chrome, service);
    await building(chrome, service);
  }
} finally {
  await stop();
}
process.exit(result());
