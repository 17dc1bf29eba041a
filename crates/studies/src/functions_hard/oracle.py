"""Writes oracle.rs: values of BBOB functions as COCO computes them (pip install coco-experiment; 2.8.2).

    python oracle.py > oracle.rs
"""

import math

import cocoex

print("//! Values of BBOB functions, computed by COCO (cocoex 2.8.2) with `oracle.py`: number, instance,")
print("//! dimensions, and the values at three places.")
print()
print("/// The places are those of the test that reads this.")
print("pub const COCO: [(i64, i64, usize, [f64; 3]); 52] = [")
for number in [1, 2, 3, 9, 10, 11, 12, 14, 15, 16, 17, 19, 21]:
    for dimensions in [5, 10]:
        for instance in [1, 3]:
            options = f"function_indices:{number} dimensions:{dimensions} instance_indices:{instance}"
            suite = cocoex.Suite("bbob", "instances: 1-5", options)
            problem = suite[0]
            values = []
            for place in range(3):
                x = [4.5 * math.sin(1 + 2.3 * place + 1.7 * i) for i in range(dimensions)]
                values.append(repr(float(problem(x))))
            print(f"    ({number}, {instance}, {dimensions}, [{', '.join(values)}]),")
print("];")
