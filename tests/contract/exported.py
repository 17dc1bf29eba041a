"""The written models do what the service does: their free runs, against those of the fits that they were written from.

    exported.py ADDRESS

Runs in an environment with numpy and casadi. Every built-in room model, an effect with a delay and some others are
fitted to what a made-up house would show; how well they fit does not matter.
"""

import math
import sys
import time
import types
import urllib.request

import casadi
import numpy
import service

MODELS = [
    "ti", "tith", "tite", "titeth", "rc1", "rc2", "rc1_heater", "rc2_heater", "room2", "room3",
    "room3+pipe_delay", "room3+wind_infiltration", "room3+sensor_lag", "room3+window_opening", "rc2+sky_radiation",
]
STEP_S = 1800
SAMPLES = 9 * 48
# Between the service's free run and one by a written model, in the unit of the output.
SAME = 1e-6


def house():
    """Half-hourly channels of a house over nine days."""
    hours = [k * STEP_S / 3600 for k in range(SAMPLES)]

    def wave(mean, swing, period, shift=0.0):
        return [mean + swing * math.sin(2 * math.pi * (hour / period + shift)) for hour in hours]

    held = [1.0 if (k // 5) % 3 else 0.2 for k in range(SAMPLES)]
    return {
        "T_room": [a + b for a, b in zip(wave(21, 0.8, 24), wave(0, 0.3, 7))],
        "T_out": [a + b for a, b in zip(wave(4, 5, 24, 0.4), wave(0, 2, 61))],
        "T_forward": wave(38, 6, 11),
        "P_heater": [2.0 * value for value in held],
        "valve": held,
        "window_open": [1.0 if k % 48 == 20 else 0.0 for k in range(SAMPLES)],
        "irradiance": [max(0.0, value) for value in wave(50, 350, 24, 0.75)],
        "cloud_cover": wave(0.5, 0.4, 31),
        "wind_speed": [abs(value) for value in wave(4, 5, 17)],
    }


def text(base, path):
    with urllib.request.urlopen(base + path) as answer:
        return answer.read().decode()


def module(base, path, form):
    """A written Python module, run."""
    found = types.ModuleType(form)
    exec(compile(text(base, f"{path}?format={form}"), f"{path} as {form}", "exec"), found.__dict__)
    return found


def measured(base, system, document, channels):
    """A system with nine days of channels."""
    moments = [time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(1_767_571_200 + k * STEP_S)) for k in range(SAMPLES)]
    service.ask(base, "PUT", f"/systems/{system}", document)
    service.ask(base, "POST", f"/systems/{system}/windows", {"time": moments, "values": channels})


def fitted(base, place, model):
    """A fit of the model, whatever the gate says."""
    system = f"room/exported{place}"
    measured(base, system, {"model": model, "neighbours": ["room/next_door"]}, house())
    asked = {
        "kind": "estimate", "system": system, "experiment": True, "budget": {"evaluations": 300},
        "method": {"name": "lm_multistart", "seed": 1}, "split": {"train": "P7D", "validation": "P2D", "test": "P0D"},
    }
    job = service.ended(base, service.ask(base, "POST", "/jobs", asked)["id"])
    if not job.get("fit"):
        raise RuntimeError(f"{model} has no fit: {job}")
    return job["fit"]


def inputs_of(compared, written):
    """The columns of a written model: what drove the free run."""
    lines = compared["inputs"]
    return numpy.array([lines[channel]["values"] for channel, _ in written.INPUTS], float).T


def checked(base, place, model):
    fit = fitted(base, place, model)
    path = f"/fits/{fit}/model"
    compared = service.ask(base, "GET", f"/fits/{fit}/comparison?mode=free_run&max_points=20000")
    written = module(base, path, "python")
    document = service.ask(base, "GET", path)
    output = compared["outputs"][written.OUTPUTS[0][0]]
    told = numpy.array(output["simulated"]["values"], float)
    shown_by_sensor = numpy.array(output["measured"]["values"], float)
    inputs = inputs_of(compared, written)
    hours = STEP_S / 3600
    # What is delayed is not known at once; the service stands still until it is, and starts from the sensor there.
    known = numpy.isfinite(told)
    known[0] = False
    first = int(numpy.argmax(known)) - 1
    start = [shown_by_sensor[first : first + 3].mean() if value is None else value for value in written.START]
    states = [numpy.array(start)] + [None] * (len(inputs) - 1 - first)
    steps = max(math.ceil(hours / written.LONGEST_STEP_H - 1e-9), 1)
    for place, k in enumerate(range(first, len(inputs) - 1)):
        x = states[place]
        for part in range(steps):
            ends = (written.entering(inputs, k, (part + end) / steps, hours) for end in (0, 1))
            x = written.step(x, *ends, hours / steps)
        states[place + 1] = x
    if first == 0:
        assert numpy.array_equal(numpy.array(states), written.simulate(start, inputs, hours))
    shown = [written.outputs(x, written.entering(inputs, first + k, 0.0, hours))[0] for k, x in enumerate(states)]
    off = float(numpy.abs(numpy.array(shown) - told[first:])[1:].max())

    other = module(base, path, "casadi")
    values = casadi.DM(list(other.PARAMETERS.values()))
    step, x = other.step(hours), casadi.DM(start)
    shown = []
    whole = all(abs(delay / hours - round(delay / hours)) < 1e-9 for delay in other.DELAYS_H)

    def entering(k):
        return casadi.DM(list(written.entering(inputs, min(k, len(inputs) - 1), 0.0, hours)))

    for k in range(len(inputs)):
        shown.append(float(other.outputs(x, entering(k), values)[0]))
        x = step(x, entering(k), entering(k + 1), values)
    # A delay that is no whole number of samples bends within a step, which a function of both ends cannot know.
    off_casadi = float(numpy.abs(numpy.array(shown) - told).max()) if whole and first == 0 else 0.0
    assert len(document["states"]) == len(written.STATES) and document["model"] == model, document
    for parameter in document["parameters"]:
        assert written.PARAMETERS[parameter["symbol"]] == parameter["value"], parameter
    modelica = text(base, f"{path}?format=modelica")
    assert modelica.startswith("model Lampyris_") and modelica.count("der(") == len(written.STATES), modelica
    latex = text(base, f"{path}?format=latex")
    assert latex.count("{") == latex.count("}") and latex.count("\\left") == latex.count("\\right"), latex
    print(f"{model}: numpy {off:.1e}, casadi {off_casadi:.1e} off over {SAMPLES} samples")
    return off <= SAME and off_casadi <= SAME and numpy.isfinite([off, off_casadi]).all()


def main():
    base = sys.argv[1]
    room = house()["T_room"]
    measured(base, "room/next_door", {"model": "rc1"}, {"T_room": room[5:] + room[:5]})
    wrong = [model for place, model in enumerate(MODELS) if not checked(base, place, model)]
    if wrong:
        print(f"written models differ from the service: {', '.join(wrong)}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
