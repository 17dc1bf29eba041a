"""Median evaluations of pycma until an error of 1e-8, over 15 seeds (pip install cma numpy; 4.5.0): the figures
that the test of bipop.rs expects.

    python pycma.py
"""

import statistics

import cma


def ellipsoid(x):
    return sum(1e6 ** (i / (len(x) - 1)) * v * v for i, v in enumerate(x))


def rosenbrock(x):
    return sum(100 * (b - a * a) ** 2 + (a - 1) ** 2 for a, b in zip(x, x[1:]))


def sphere(x):
    return sum(v * v for v in x)


def evaluations(cost, start, dimensions, seed):
    """Until the target, of one run that does not restart; none is told as many as a run may take."""
    options = {"seed": seed, "verbose": -9, "ftarget": 1e-8}
    run = cma.CMAEvolutionStrategy(dimensions * [start], 1.0, options)
    while not run.stop():
        batch = run.ask()
        costs = [cost(x) for x in batch]
        hits = [i for i, value in enumerate(costs) if value <= 1e-8]
        if hits:
            return run.countevals + hits[0] + 1
        run.tell(batch, costs)
    return 10**9


for cost, start in [(sphere, 3.0), (ellipsoid, 3.0), (rosenbrock, 0.0)]:
    for dimensions in [5, 10]:
        counts = [evaluations(cost, start, dimensions, seed) for seed in range(1, 16)]
        print(cost.__name__, dimensions, statistics.median(counts))
