// What forecasts said, beside what came: nothing yet, a service that fails, and the errors by lead.
import { ask, holds, test } from './harness.js';

const PLACE = '**/systems/room/5/forecast/scores';

export async function said(chrome, { base }) {
  await test(chrome, 'what_was_said_stands_beside_what_came', {}, async page => {
    const kept = await ask(base, '/systems/room/5/forecast/scores');
    holds(kept.forecasts === 0, 'somebody has asked for a forecast of room/5');
    await page.goto(`${base}/ui/systems/room/5/parameters`);
    await page.getByText('No forecasts yet').waitFor();
    // It fails, and comes when it is asked again; of what was said, nothing has come.
    let answer = { status: 500, contentType: 'application/problem+json', body: JSON.stringify({ type: 'internal', title: 'A fault', status: 500, detail: 'x' }) };
    const say = document => {
      answer = { status: 200, contentType: 'application/json', body: JSON.stringify(document) };
    };
    await page.route(PLACE, route => route.fulfill(answer));
    await page.reload();
    const failed = page.getByRole('alert').filter({ hasText: 'A fault' });
    await failed.waitFor();
    const none = { rmse: null, bias: null, within95: null, persistence: null };
    const whole = {
      system: 'room/5', forecasts: 1, from: '2026-01-05T00:00:00Z', to: '2026-01-05T00:00:00Z', revisions: [1],
      outputs: { T_room: { unit: 'degC', leads: [{ lead: 'PT1H', n: 0, ...none }] } },
    };
    say(whole);
    await failed.getByRole('button', { name: 'Try again' }).click();
    await page.getByText('Nothing has come yet').waitFor();
    const scored = (lead, rmse, persistence) => ({ lead, n: 90, rmse, bias: -0.02, within95: 0.944, persistence });
    whole.outputs.T_room.leads = [scored('PT1H', 0.12, 0.25), scored('PT24H', 0.42, 1.7), scored('P2D', 0.61, 1.9), { lead: 'P10D', n: 0, ...none }];
    say({ ...whole, forecasts: 90 });
    await page.reload();
    const frame = page.getByRole('figure', { name: 'Error of what was said, T_room' });
    await frame.getByRole('img', { name: 'by hours ahead' }).waitFor();
    const rows = await frame.locator('tbody tr').allInnerTexts();
    holds(rows.length === 3, rows.join('; '));
    holds(/^24 h\t90\t0.42 degC\t1.7 degC\t.0.020 degC\t94 %$/.test(rows[1]), rows[1]);
    holds(rows[2].startsWith('2 d\t'), rows[2]);
  });
}
