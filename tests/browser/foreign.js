// Pages of others, open in the browser of somebody who may ask an open service: they can do nothing to it.
import { once } from 'node:events';
import http from 'node:http';
import { ask, bare, browser, holds, test } from './harness.js';

const EVIL = 'evil.example';
/** What a form can send without being asked about, and what it would start. */
const FORMS = ['text/plain', 'application/x-www-form-urlencoded', 'multipart/form-data'];

/** What the browser says of a foreign page that tries. */
const expected = /^Failed to load resource|has been blocked by CORS policy|violates the following Content Security Policy directive: "frame-ancestors/;

/** A page on another port: another origin of the same machine. */
async function foreignPage() {
  const server = http.createServer((_, response) => response.setHeader('content-type', 'text/html').end('<title>foreign</title>'));
  server.listen(0, '127.0.0.1');
  await once(server, 'listening');
  return { base: `http://127.0.0.1:${server.address().port}`, close: () => server.close() };
}

/** Everything that a page could have changed, as the service itself tells it. */
async function stateOf(base) {
  const paths = ['/systems', '/systems/room/4', '/params', '/jobs', '/batches', '/models', '/effects', '/schedules/nightly', '/audit'];
  return JSON.stringify(await Promise.all(paths.map(path => ask(base, path))), (name, value) => (name === 'next_runs' ? [] : value));
}

/** Does something on a page, and gives the statuses that its changes were answered with. */
async function statuses(page, base, act) {
  const seen = [];
  const listen = response => response.url().startsWith(base) && response.request().method() !== 'GET' && seen.push(response.status());
  page.on('response', listen);
  await act();
  const until = Date.now() + 5000;
  while (seen.length === 0 && Date.now() < until) await page.waitForTimeout(20);
  page.off('response', listen);
  return seen;
}

/** How many changes the service has refused to foreign pages: their browser keeps the answers from them. */
async function refusals(base) {
  const text = await (await fetch(`${base}/metrics`)).text();
  const lines = text.split('\n').filter(line => line.startsWith('http_requests_total{') && line.includes('code="403"'));
  return lines.reduce((sum, line) => sum + Number(line.split(' ').at(-1)), 0);
}

/** Has a page send a form; what is answered would be shown in a frame. */
const submit = (page, action, type) =>
  page.evaluate(
    ([to, enctype]) => {
      const frame = Object.assign(document.createElement('iframe'), { name: 'answer' });
      const form = Object.assign(document.createElement('form'), { action: to, method: 'post', enctype, target: 'answer' });
      form.append(Object.assign(document.createElement('input'), { name: '{"kind":"recalibrate","x":"', value: '"}' }));
      document.body.replaceChildren(frame, form);
      form.submit();
    },
    [action, type],
  );

export async function foreign(chrome, binary) {
  const { base, stop } = await bare(binary);
  const other = await foreignPage();
  try {
    await ask(base, '/systems/room/4', { label: 'Kitchen', model: 'rc2' }, 'PUT');
    const before = await stateOf(base);
    const isUntouched = async what => holds((await stateOf(base)) === before, `${what} has changed something: ${await stateOf(base)}`);
    const run = `${base}/schedules/nightly/run`;

    await test(chrome, 'a_form_of_a_foreign_page_starts_nothing', {}, async page => {
      await page.goto(other.base);
      for (const type of FORMS) {
        const answered = await statuses(page, base, () => submit(page, run, type));
        holds(answered.join() === '403', `${type}: ${answered}`);
        await isUntouched(`a form of ${type}`);
      }
    });

    await test(chrome, 'a_script_of_a_foreign_page_sends_nothing_that_counts', { expected }, async page => {
      await page.goto(other.base);
      const sends = {
        'a post without a body': to => fetch(to, { mode: 'no-cors', method: 'POST' }).catch(() => 'kept from the page'),
        'a post with a body': to =>
          fetch(to, { mode: 'no-cors', method: 'POST', body: '{"kind":"recalibrate","systems":["room/*"]}' }).catch(() => 'kept from the page'),
        'a post without a name': to =>
          fetch(to, { mode: 'no-cors', method: 'POST', body: new Blob(['{}']), referrerPolicy: 'no-referrer' }).catch(() => 'kept from the page'),
        'a beacon': to => navigator.sendBeacon(to, '{"kind":"recalibrate","systems":["room/*"]}'),
      };
      for (const path of ['/schedules/nightly/run', '/jobs']) {
        for (const [what, send] of Object.entries(sends)) {
          const before = await refusals(base);
          await page.evaluate(`(${send})(${JSON.stringify(base + path)})`);
          const until = Date.now() + 5000;
          while ((await refusals(base)) === before && Date.now() < until) await page.waitForTimeout(20);
          holds((await refusals(base)) === before + 1, `${what} to ${path} was not refused`);
          await isUntouched(what);
        }
      }
      // What the browser asks about first gets no consent, and is not sent.
      for (const [method, path] of [['POST', '/jobs'], ['PUT', '/systems/room/5'], ['PUT', '/params/room/4/pin'], ['DELETE', '/systems/room/4']]) {
        const sent = await page.evaluate(
          ([to, verb]) =>
            fetch(to, { method: verb, headers: { 'content-type': 'application/json' }, body: '{"model":"rc2"}' }).then(
              response => `answered ${response.status}`,
              () => 'refused',
            ),
          [base + path, method],
        );
        holds(sent === 'refused', `${method} ${path}: ${sent}`);
        await isUntouched(`${method} ${path}`);
      }
    });

    await test(chrome, 'a_foreign_page_reads_nothing', { expected }, async page => {
      await page.goto(other.base);
      for (const path of ['/systems', '/params/room/4', '/systems/room/4', '/audit', '/metrics', '/ui/']) {
        const read = await page.evaluate(async from => {
          const plain = await fetch(from).then(response => response.text(), () => '');
          const opaque = await fetch(from, { mode: 'no-cors' }).then(response => response.text(), () => '');
          const part = tag =>
            new Promise(done => {
              const element = Object.assign(document.createElement(tag), { onload: () => done(element), onerror: () => done(null), src: from });
              document.body.append(element);
            });
          const names = Object.keys(window).join();
          const image = await part('img');
          // Plain text is tried as a script, and is none: its fault is told to nobody.
          if (!from.endsWith('/metrics')) await part('script');
          return plain + opaque + (image?.naturalWidth ?? '') + (Object.keys(window).join() === names ? '' : 'a new name');
        }, base + path);
        holds(read === '', `${path} is read: ${read.slice(0, 200)}`);
      }
      // Events go to nobody else, and nothing may frame the page.
      const streams = await page.evaluate(from => new Promise(done => {
        const source = new EventSource(from);
        source.onopen = () => done('open');
        source.onerror = () => done('closed');
      }), `${base}/events`);
      holds(streams === 'closed', 'a foreign page hears the events');
      await page.evaluate(from => document.body.replaceChildren(Object.assign(document.createElement('iframe'), { src: from })), `${base}/ui/`);
      await page.waitForFunction(() => window.length === 1);
      const frame = page.frames()[1];
      await frame.waitForLoadState();
      holds(!(await frame.locator('#main').count()), 'the page is framed');
    });

    await test(chrome, 'the_own_page_works_by_both_names_of_the_machine', {}, async page => {
      for (const name of ['localhost', '127.0.0.1']) {
        await page.goto(`${base.replace('127.0.0.1', name)}/ui/schedules`);
        for (const [word, state] of [['Pause', false], ['Resume', true]]) {
          await page.getByRole('button', { name: `${word} nightly` }).click();
          await page.getByRole('button', { name: `${state ? 'Pause' : 'Resume'} nightly` }).waitFor();
          holds((await ask(base, '/schedules/nightly')).enabled === state, `${name}: ${word}`);
        }
      }
    });

    await rebound(base);
  } finally {
    other.close();
    await stop();
  }
}

/** A name of others that leads to this machine: to the browser its page and the service are of one origin. */
async function rebound(base) {
  const chrome = await browser([`--host-resolver-rules=MAP ${EVIL} 127.0.0.1`]);
  const before = await stateOf(base);
  try {
    await test(chrome, 'a_name_that_was_bent_to_this_machine_leads_nowhere', {}, async page => {
      const evil = base.replace('127.0.0.1', EVIL);
      // The files of the page are no secret; what it shows comes from the service, which does not go by that name.
      await page.goto(`${evil}/ui/`);
      await page.getByRole('alert').getByText(`does not go by the name \`${EVIL}\``).waitFor();
      const asked = await page.evaluate(async () => {
        const json = { 'content-type': 'application/json' };
        const requests = [
          ['/systems', {}],
          ['/params', {}],
          ['/audit', {}],
          ['/systems/room/5', { method: 'PUT', headers: json, body: '{"model":"rc2"}' }],
          ['/systems/room/4', { method: 'DELETE' }],
          ['/params/room/4/pin', { method: 'PUT', headers: json, body: '{"reason":"none"}' }],
          ['/jobs', { method: 'POST', headers: json, body: '{"kind":"recalibrate","systems":["room/*"]}' }],
          ['/schedules/nightly/run', { method: 'POST' }],
        ];
        const answers = [];
        for (const [path, options] of requests) {
          const response = await fetch(path, options);
          answers.push({ path, status: response.status, ...(await response.json()) });
        }
        return answers;
      });
      const through = asked.filter(({ status, type }) => status !== 421 || type !== 'unknown-host');
      holds(through.length === 0, JSON.stringify(through));
      holds((await stateOf(base)) === before, `something has changed: ${await stateOf(base)}`);
    });
  } finally {
    await chrome.close();
  }
}
