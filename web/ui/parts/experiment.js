// Fits that change nothing that is served: a model is tried on the measurements, and on the split, of a diagnosis.
import { ask, post } from '../api.js';

/** A fall of less than one per cent is none. */
export const FALL = 0.99;

/** A model with one effect more. */
export const grownBy = (model, effect) => post(`/models/${encodeURIComponent(model)}/effects`, { effect });

/** The model that a base becomes with effects, made where it is not there yet. */
export async function grownFrom(base, effects) {
  let model = base;
  for (const effect of effects) model = (await grownBy(model, effect)).id;
  return model;
}

/** Starts the fit of a model as an experiment; `request` is that of the job that diagnosed. Gives the job. */
export async function experiment(system, model, { split, window, objective, prior, bounds, fixed }) {
  const own = (await ask(`/models/${encodeURIComponent(model)}`)).parameters.map(parameter => parameter.name);
  const within = values => Object.fromEntries(Object.entries(values ?? {}).filter(([parameter]) => own.includes(parameter)));
  return post('/jobs', {
    kind: 'estimate',
    system,
    model,
    experiment: true,
    split,
    objective,
    prior,
    bounds: within(bounds),
    fixed: within(fixed),
    ...(window ? { window } : {}),
  });
}
