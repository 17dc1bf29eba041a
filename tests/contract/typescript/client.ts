// A client with types from the description reads a room's model, a plant's, a fit, a diagnosis and a forecast:
//
//     node built/client.js ADDRESS SYSTEM FIT DIAGNOSIS
import assert from 'node:assert/strict';
import createClient from 'openapi-fetch';
import type { components, paths } from './api.js';

type Schemas = components['schemas'];

/** Documents that nothing can be: there must be none. */
type Impossible = { [Name in keyof Schemas]: [Schemas[Name]] extends [never] ? Name : never }[keyof Schemas];
const possible: [Impossible] extends [never] ? true : Impossible = true;

const [base, system, fit, diagnosis] = process.argv.slice(2);
assert(possible && base && system && fit && diagnosis);
const client = createClient<paths>({ baseUrl: base });
const [kind, id] = system.split('/') as [string, string];
const place = { params: { path: { kind, id } } };

/** The answer to a request, which must succeed. */
async function answer<Data>(asked: Promise<{ data?: Data; error?: unknown; response: Response }>): Promise<NonNullable<Data>> {
  const { data, error, response } = await asked;
  if (data === undefined || data === null) throw new Error(`${response.status} ${JSON.stringify(error)}`);
  return data;
}

const model = (id: string) => answer(client.GET('/models/{id}', { params: { path: { id } } }));
const [room, plant] = [await model('room3'), await model('bsm1')];
const bounds: [number, number][] = room.parameters.map(parameter => [parameter.bounds[0] ?? NaN, parameter.bounds[1] ?? NaN]);
assert(bounds.length > 3 && bounds.every(([lower, upper]) => lower < upper));
const rules = room.document && 'check' in room.document ? (room.document.check ?? []) : [];
const gains = rules.flatMap(rule => (rule.kind === 'steady_gain' ? [rule.input] : []));
assert(gains.length > 0 && plant.states.length > 100, `${gains}`);

const found = await answer(client.GET('/fits/{id}', { params: { path: { id: fit } } }));
const served = await answer(client.GET('/params/{kind}/{id}', place));
const values: Record<string, number | null> = served.parameters;
for (const [name, { value, unit }] of Object.entries(found.parameters)) {
  assert(Number.isFinite(value) && unit !== '', name);
  if (served.fit === fit) assert.equal(values[name], value);
}

const said = await answer(client.GET('/diagnoses/{id}', { params: { path: { id: diagnosis } } }));
assert.equal(said.system, system);

const { at, states } = await answer(client.GET('/systems/{kind}/{id}/state', place));
const later = new Date(Date.parse(at) + 6 * 3_600_000).toISOString();
const inputs = { time: [at, later], values: { T_out: [5, 4], P_heater: [10, 10] } };
const forecast = await answer(
  client.POST('/systems/{kind}/{id}/forecast', { ...place, body: { horizon: 'PT6H', step: 'PT1H', inputs } }),
);
assert(forecast.time.length === 7 && Object.keys(states).length > 0);
for (const { values, sd } of Object.values(forecast.outputs)) assert(values.length === 7 && sd.every(one => one > 0));
console.log(`the client in TypeScript has ${Object.keys(values).length} parameters of ${served.model}, and a forecast to ${forecast.time.at(-1)}`);
