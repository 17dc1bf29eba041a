// What the tests stand on: the demo of the binary, a browser, and the count of what passed.
import { spawn } from 'node:child_process';
import { once } from 'node:events';
import { existsSync, mkdtempSync, rmSync } from 'node:fs';
import net from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { chromium } from 'playwright-core';

const PATIENCE_MS = 240_000;
/** The demo fits and diagnoses its rooms before it is done. */
const START_MS = 900_000;

async function freePort() {
  const server = net.createServer().listen(0, '127.0.0.1');
  await once(server, 'listening');
  const { port } = server.address();
  server.close();
  await once(server, 'close');
  return port;
}

/**
 * The demo: `{base, port, ready, stop}`. It has all its rooms once `ready()` has come back. Its night is paused: where
 * half past two came during the tests, it would fit rooms that they know to be empty or held.
 */
export async function demo(binary) {
  const folder = mkdtempSync(join(tmpdir(), 'lampyris-browser-'));
  const port = await freePort();
  const child = spawn(binary, ['demo', '--folder', 'demo', '--bind', `127.0.0.1:${port}`], {
    cwd: folder,
    stdio: ['ignore', 'pipe', 'pipe'],
  });
  let said = '';
  child.stdout.on('data', text => {
    said += text;
  });
  child.stderr.on('data', text => {
    said += text;
  });
  const ended = once(child, 'exit');
  const stop = async () => {
    if (child.exitCode === null) child.kill('SIGTERM');
    const late = setTimeout(() => child.kill('SIGKILL'), 8000);
    await ended;
    clearTimeout(late);
    rmSync(folder, { recursive: true, force: true });
  };
  const base = `http://127.0.0.1:${port}`;
  const until = Date.now() + START_MS;
  const waitFor = async condition => {
    while (!(await condition())) {
      if (child.exitCode !== null || Date.now() > until) {
        await stop();
        throw new Error(`the demo did not start:\n${said}`);
      }
      await new Promise(done => setTimeout(done, 100));
    }
  };
  const night = { cron: '30 2 * * *', systems: ['room/*'], enabled: false };
  await waitFor(() => ask(base, '/schedules/nightly', night, 'PUT').then(() => true, () => false));
  return { base, port, ready: () => waitFor(() => said.includes('What a controller gets')), stop };
}

/** A service of its own, with nothing in it: `{base, database, stop}`. `prepare` gets the database before it starts. */
export async function bare(binary, prepare = () => {}) {
  const folder = mkdtempSync(join(tmpdir(), 'lampyris-browser-'));
  const database = join(folder, 'test.db');
  prepare(database);
  const base = `http://127.0.0.1:${await freePort()}`;
  const child = spawn(binary, ['serve', '--bind', base.slice('http://'.length), '--database', database], { stdio: ['ignore', 'pipe', 'ignore'] });
  const ended = once(child, 'exit');
  await once(child.stdout, 'data');
  const stop = async () => {
    child.kill('SIGTERM');
    await ended;
    rmSync(folder, { recursive: true, force: true });
  };
  return { base, database, stop };
}

/** A line to the service that can be cut: `cut()` ends every connection and refuses new ones, `mend()` lets them in again. */
export async function wire(port) {
  const open = new Set();
  let whole = true;
  const server = net
    .createServer(near => {
      if (!whole) {
        near.destroy();
        return;
      }
      const far = net.connect(port, '127.0.0.1');
      for (const socket of [near, far]) {
        open.add(socket);
        socket.on('error', () => {});
        socket.on('close', () => {
          open.delete(socket);
          near.destroy();
          far.destroy();
        });
      }
      near.pipe(far).pipe(near);
    })
    .listen(0, '127.0.0.1');
  await once(server, 'listening');
  return {
    base: `http://127.0.0.1:${server.address().port}`,
    cut: () => {
      whole = false;
      open.forEach(socket => socket.destroy());
    },
    mend: () => {
      whole = true;
    },
    close: () => {
      open.forEach(socket => socket.destroy());
      server.close();
    },
  };
}

export async function browser(args = []) {
  const path = [process.env.CHROMIUM, '/usr/bin/chromium', '/usr/bin/chromium-browser', '/usr/bin/google-chrome'].find(
    candidate => candidate && existsSync(candidate),
  );
  if (!path) throw new Error('no Chromium: apt-get install chromium');
  return chromium.launch({ executablePath: path, args: ['--no-sandbox', ...args] });
}

const counted = { passed: 0, failed: 0 };

/** A refused request is part of some stories; a script, a style or a policy that fails never is. */
const REFUSED = /^Failed to load resource/;

/** Opens a page at a width, with a scheme; what goes wrong in it, other than what is `expected`, is a fault of the test. */
export async function open(chrome, { width = 1366, height = 768, scheme = 'light', motion = 'reduce', zone = 'UTC', expected = REFUSED } = {}) {
  const context = await chrome.newContext({
    viewport: { width, height },
    colorScheme: scheme,
    reducedMotion: motion,
    timezoneId: zone,
    acceptDownloads: true,
  });
  context.setDefaultTimeout(PATIENCE_MS);
  const page = await context.newPage();
  const faults = [];
  page.on('pageerror', error => faults.push(`${error.message}\n${error.stack}`));
  page.on('console', message => message.type() === 'error' && !expected.test(message.text()) && faults.push(message.text()));
  return { page, faults, close: () => context.close() };
}

/** Runs a test on a page of its own. */
export async function test(chrome, name, options, body) {
  const begun = Date.now();
  const took = () => `<${((Date.now() - begun) / 1000).toFixed(3)}s>`;
  const place = await open(chrome, options);
  try {
    await body(place.page);
    if (place.faults.length) throw new Error(place.faults.join('\n'));
    counted.passed += 1;
    console.log(`test ${name} ... ok ${took()}`);
  } catch (error) {
    counted.failed += 1;
    console.log(`test ${name} ... FAILED ${took()}\n${error.stack ?? error}\n  at ${place.page.url()}`);
    if (process.env.BROWSER_SHOTS)
      await place.page.screenshot({ path: join(process.env.BROWSER_SHOTS, `FAILED ${name}.png`), fullPage: true }).catch(() => {});
  } finally {
    await place.close();
  }
}

/** The line that the one test command counts; the exit code. */
export function result() {
  console.log(`\ntest result: ${counted.failed ? 'FAILED' : 'ok'}. ${counted.passed} passed; ${counted.failed} failed; 0 ignored`);
  return counted.failed ? 1 : 0;
}

export function holds(condition, text) {
  if (!condition) throw new Error(text);
}

/** Two weeks of a room that follows the day, so many hours late, and of the weather. */
export function fortnight(late = 0) {
  const rows = Array.from({ length: 24 * 14 }, (_, hour) => {
    const wave = lag => Math.sin(((hour - lag) / 12) * Math.PI);
    return `${new Date(Date.UTC(2026, 0, 5, hour)).toISOString()},${(20 + 2 * wave(late)).toFixed(2)},${(3 + 4 * wave(0)).toFixed(2)}`;
  });
  return ['time,T_room[degC],T_out[degC]', ...rows].join('\n');
}

/** Asks the service beside the page; a body is JSON, or CSV where it is a text. */
export async function ask(base, path, body, method = body ? 'POST' : 'GET') {
  const csv = typeof body === 'string';
  const response = await fetch(base + path, {
    method,
    headers: body ? { 'content-type': csv ? 'text/csv' : 'application/json' } : {},
    body: csv ? body : body && JSON.stringify(body),
  });
  if (!response.ok) throw new Error(`${method} ${path}: ${response.status} ${await response.text()}`);
  return response.status === 204 ? null : response.json();
}
