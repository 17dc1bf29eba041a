// Two changes of one document, brought together field by field.

const isRecord = value => value !== null && typeof value === 'object' && !Array.isArray(value);
const areSame = (one, other) => JSON.stringify(one) === JSON.stringify(other);
const namesOf = records => [...new Set(records.flatMap(record => Object.keys(record)))];

/** What was written into a form that began as `before`, on what is there `now`: fields that it left alone are as they are now. */
export function onto(now, before, written) {
  if (![now, before, written].every(isRecord)) return areSame(before, written) ? now : written;
  const merged = namesOf([now, before, written]).map(name => [name, onto(now[name], before[name], written[name])]);
  return Object.fromEntries(merged.filter(([, value]) => value !== undefined));
}

/** The fields in which two documents differ, such as `['policy/mode', 'auto', 'observe']`. */
export function differences(one, other, path = []) {
  if (![one, other].every(isRecord)) return areSame(one, other) ? [] : [[path.join('/'), one, other]];
  return namesOf([one, other]).flatMap(name => differences(one[name], other[name], [...path, name]));
}
