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
# The same of a plant, in the swing of each output over the record: its stepper keeps to a tolerance of its own.
SAME_PLANT = 1e-5


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


# A week's influent of a plant: the mean of each channel, and by how much of it the day moves it.
INFLUENT = {
    "Q": (18446, 0.4), "S_I": (30, 0), "S_S": (69.5, 0.3), "X_I": (51.2, 0.3), "X_S": (202.32, 0.3), "X_BH": (28.17, 0.3),
    "X_BA": (0, 0), "X_P": (0, 0), "S_O": (0, 0), "S_NO": (0, 0), "S_NH": (31.56, 0.3), "S_ND": (6.95, 0.3),
    "X_ND": (10.59, 0.3), "S_ALK": (7, 0),
}
EFFLUENT = {"S_S_e": 2.7, "X_S_e": 0.1, "S_NH_e": 2.6, "S_NO_e": 28.1}


def plant():
    """Half-hourly channels of a plant over nine days."""
    shape = [math.sin(2 * math.pi * k / 48) + 0.3 * math.sin(2 * math.pi * k / 331) for k in range(SAMPLES)]
    influent = {channel: [mean * (1 + share * at) for at in shape] for channel, (mean, share) in INFLUENT.items()}
    return influent | {channel: [level * (1 + 0.1 * at) for at in shape] for channel, level in EFFLUENT.items()}


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


def fitted(base, system, model, document, channels, **request):
    """A fit of the model, whatever the gate says."""
    measured(base, system, {"model": model} | document, channels)
    asked = {
        "kind": "estimate", "system": system, "experiment": True,
        "method": {"name": "lm_multistart", "seed": 1}, "split": {"train": "P7D", "validation": "P2D", "test": "P0D"},
    } | request
    job = service.ended(base, service.ask(base, "POST", "/jobs", asked)["id"])
    if not job.get("fit"):
        raise RuntimeError(f"{model} has no fit: {job}")
    return job["fit"]


def inputs_of(compared, written):
    """The columns of a written model: what drove the free run."""
    lines = compared["inputs"]
    return numpy.array([lines[channel]["values"] for channel, _ in written.INPUTS], float).T


def checked(base, place, model):
    document = {"neighbours": ["room/next_door"]}
    fit = fitted(base, f"room/exported{place}", model, document, house(), budget={"evaluations": 300})
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
    estimated = service.ask(base, "GET", f"/fits/{fit}")["starts"].get(written.OUTPUTS[0][0], {}).get("value")
    sensed = estimated if first == 0 and estimated is not None else shown_by_sensor[first : first + 3].mean()
    start = [sensed if value is None else value for value in written.START]
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


def checked_plant(base):
    """A plant against the BDF method of SUNDIALS, by the rates that were written for CasADi."""
    fixed = {"b_H": 0.62, "mu_H": 6.0, "K_OA": 0.5, "K_NH": 1.0, "K_S": 20.0, "Y_H": 0.67}
    fit = fitted(base, "plant/exported", "asm1_n", {}, plant(), fixed=fixed, budget={"evaluations": 10})
    compared = service.ask(base, "GET", f"/fits/{fit}/comparison?mode=free_run&max_points=20000")
    path = f"/fits/{fit}/model"
    written, other = module(base, path, "python"), module(base, path, "casadi")
    inputs, hours = inputs_of(compared, written), STEP_S / 3600
    x, u = casadi.SX.sym("x", len(other.STATES)), casadi.SX.sym("u", len(other.COLUMNS))
    values = casadi.DM(list(other.PARAMETERS.values()))
    problem = {"x": x, "p": u, "ode": other.rates(x, u, values)}
    precise = {"reltol": 1e-9, "abstol": 1e-9, "max_num_steps": 100_000}
    over = casadi.integrator("over", "cvodes", problem, 0.0, hours, precise)
    state, shown, rates_differ = numpy.array(other.START, float), [], 0.0
    for k in range(len(inputs)):
        entering = written.entering(inputs, k, 0.0, hours)
        shown.append(numpy.array(other.outputs(state, entering, values)).ravel())
        if k % 48 == 0:
            one, two = written.rates(state, entering), numpy.array(other.rates(state, entering, values)).ravel()
            rates_differ = max(rates_differ, float(numpy.abs(one - two).max() / numpy.abs(two).max()))
        state = numpy.array(over(x0=state, p=entering)["xf"]).ravel()
    told = numpy.array([compared["outputs"][channel]["simulated"]["values"] for channel, _ in other.OUTPUTS], float).T
    swing = told.max(axis=0) - told.min(axis=0)
    off = float((numpy.abs(numpy.array(shown) - told).max(axis=0) / swing).max())
    print(f"asm1_n: cvodes {off:.1e} of the swing off over {SAMPLES} samples, rates {rates_differ:.1e} apart")
    return off <= SAME_PLANT and rates_differ <= 1e-12


def main():
    base = sys.argv[1]
    room = house()["T_room"]
    measured(base, "room/next_door", {"model": "rc1"}, {"T_room": room[5:] + room[:5]})
    wrong = [model for place, model in enumerate(MODELS) if not checked(base, place, model)]
    if not checked_plant(base):
        wrong.append("asm1_n")
    if wrong:
        print(f"written models differ from the service: {', '.join(wrong)}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
