// The states that a controller begins its forecasts from, beside the parameters.
import { ask, holds, test } from './harness.js';

export async function states(chrome, { base }) {
  await test(chrome, 'the_states_now_stand_beside_the_parameters_with_unit_and_deviation', {}, async page => {
    const { at, sd, revision, states: values } = await ask(base, '/systems/room/5/state');
    await page.goto(`${base}/ui/systems/room/5/parameters`);
    const frame = page.getByRole('figure', { name: 'States at the newest sample' });
    await frame.getByText(`by revision ${revision}.`).last().waitFor();
    await frame.getByRole('cell', { name: 'degC' }).first().waitFor();
    const rows = await frame.locator('tbody tr').allInnerTexts();
    holds(rows.length === Object.keys(values).length, rows.join('; '));
    for (const [index, [name, value]] of Object.entries(values).entries()) {
      const [shown, number, deviation, unit] = rows[index].split('\t');
      holds(shown === name && Math.abs(number - value) < 0.01 && Math.abs(deviation - sd[name]) < 0.1 * sd[name], rows[index]);
      holds(unit === 'degC', `${name} is in ${unit}`);
    }
    holds((await frame.innerText()).includes(String(new Date(at).getUTCFullYear())), 'the time is not said');
    // Those of a free run have no deviation, and say what they are.
    await page.goto(`${base}/ui/systems/plant/north/parameters`);
    await frame.getByText('of a free run, which no measurement has corrected').last().waitFor();
    await page.goto(`${base}/ui/systems/room/1/parameters`);
    await page.getByText('No states yet').waitFor();
  });
}
