// Lines of an answer as a chart draws them.

/** The values of a line, or its extremes where it is thinned. */
export const linesOf = line => (line.values ? { values: line.values } : { min: line.min, max: line.max });

/**
 * A line whose sensor samples less often than the others: what lies between two of its samples is no gap and has no value of
 * its own. The lengths of the holes are compared with the shortest one.
 */
export function sampled(line) {
  const { values } = line;
  if (!values) return line;
  const known = values.flatMap((value, at) => (value === null ? [] : [at]));
  const steps = known.slice(1).map((at, index) => at - known[index]);
  const step = Math.min(...steps);
  if (!Number.isFinite(step) || step === 1) return line;
  const between = new Set(steps.flatMap((length, index) => (length === step ? Array.from({ length: length - 1 }, (_, at) => known[index] + 1 + at) : [])));
  return { values: values.map((value, at) => (value === null && (between.has(at) || (at < known[0] && known[0] < step) || (at > known.at(-1) && at < known.at(-1) + step)) ? undefined : value)) };
}
