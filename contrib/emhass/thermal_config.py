#!/usr/bin/env python3
"""Makes EMHASS's `thermal_config` of the room model that Lampyris serves.

    thermal_config.py http://127.0.0.1:8080 room/4 --power P_heater --nominal 2.0 [--step 30] [--horizon 24]

EMHASS plans with a room of one state:

    T[k+1] = T[k] + step * (heating_rate * P[k] / P_nominal - cooling_constant * (T[k] - T_out[k]))

A served model has the states that its measurements show, an envelope for instance, and forgets none of them. This asks for
its matrices (`GET /systems/{kind}/{id}/linearisation`) and lays the room of one state through what they say of the hours to
come, from the states as they are now, with the heater off, on and in blocks. What the one state cannot say is told: `rmse`
is the difference that remains, in kelvin, and `outdoor_offset` is to be added to EMHASS's `outdoor_temperature_forecast`:
warmth of the walls, sun and people, which this room has and that equation has not. It holds for now, so ask before each plan.

`cooling_constant` is per hour, as EMHASS 0.17 takes it. Version 0.13 and those before took it per step: `--per-step`.
Nothing but the standard library is needed. LAMPYRIS_TOKEN is shown where the service wants one (scope `read`).
"""

import argparse
import json
import math
import os
import sys
import urllib.error
import urllib.request


# Kelvins by which the outdoor temperature may be moved. Where the weather hardly reaches a room within the horizon, nothing else
# would keep a tiny cooling constant from going with a climate that no planet has.
LARGEST_OFFSET = 20.0


class Unusable(Exception):
    """A served model that cannot be put into this form, and why."""


def linearisation(url, system, minutes):
    """The matrices of one step of the model in force."""
    token = os.environ.get("LAMPYRIS_TOKEN")
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    request = urllib.request.Request(f"{url}/systems/{system}/linearisation?step=PT{minutes}M", headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return json.load(answer)
    except urllib.error.HTTPError as error:
        raise Unusable(f"{error.code} {error.read().decode()[:500]}") from None


def product(matrix, vector):
    return [sum(m * v for m, v in zip(row, vector)) for row in matrix]


def added(*vectors):
    return [sum(parts) for parts in zip(*vectors)]


def schedules(steps, hours):
    """Heater off, on, and on in blocks of three hours: shares of the nominal power, step by step."""
    block = max(1, round(3 / hours))
    return [[0.0] * steps, [1.0] * steps, [float(k // block % 2) for k in range(steps)], [float((k // block + 1) % 2) for k in range(steps)]]


def outdoors(steps, hours, now):
    """Outdoor temperatures that stay as they are, and that swing by five kelvin over a day."""
    return [[now] * (steps + 1), [now + 5 * math.sin(2 * math.pi * k * hours / 24) for k in range(steps + 1)]]


def place(model, channel):
    """Whether an input is held over a step, and where it stands."""
    for group in ("held", "moving"):
        names = [one["channel"] for one in model[group]]
        if channel in names:
            return group == "held", names.index(channel)
    there = [one["channel"] for group in ("held", "moving") for one in model[group]]
    raise Unusable(f"{model['model']} has no input {channel}; it has {', '.join(there)}")


def course(model, output, power, nominal, outdoor, shares, weather):
    """The room temperature by the served model, from now on."""
    step = model["steps"][0]
    power_is_held, power_at = place(model, power)
    outdoor_is_held, outdoor_at = place(model, outdoor)
    x, room = list(step["states"]), []
    for k in range(len(shares) + 1):
        share = shares[min(k, len(shares) - 1)]
        held, now, then = list(step["held"]), list(step["moving"]), list(step["moving_next"])
        for is_held, at, first, last in (
            (power_is_held, power_at, share * nominal, share * nominal),
            (outdoor_is_held, outdoor_at, weather[k], weather[min(k + 1, len(weather) - 1)]),
        ):
            if is_held:
                held[at] = first
            else:
                now[at], then[at] = first, last
        room.append(added(product(step["c"], x), product(step["d_held"], held), product(step["d_moving"], now), step["output_offset"])[output])
        x = added(product(step["a"], x), product(step["b"], held), product(step["e"], now), product(step["e_next"], then), step["offset"])
    return room


def answered(cooling, hours, start, shares, weather):
    """What the room of one state does from its start by itself, and by a unit of heating rate and of offset."""
    own, heated, shifted = [start], [0.0], [0.0]
    for share, outside in zip(shares, weather):
        own.append(own[-1] + hours * cooling * (outside - own[-1]))
        heated.append(heated[-1] + hours * (share - cooling * heated[-1]))
        shifted.append(shifted[-1] + hours * cooling * (1 - shifted[-1]))
    return own, heated, shifted


def fitted(cooling, hours, courses):
    """Heating rate, offset and squared error for one cooling constant: linear least squares."""
    hh = hs = ss = hr = sr = n = 0.0
    rows = []
    for shares, weather, room in courses:
        for own, h, s, wanted in zip(*answered(cooling, hours, room[0], shares, weather), room):
            r = wanted - own
            rows.append((h, s, r))
            hh, hs, ss, hr, sr, n = hh + h * h, hs + h * s, ss + s * s, hr + h * r, sr + s * r, n + 1
    determinant = hh * ss - hs * hs
    if determinant <= 1e-12 * hh * ss:
        return 0.0, 0.0, math.inf
    heating, offset = (hr * ss - sr * hs) / determinant, (sr * hh - hr * hs) / determinant
    if abs(offset) > LARGEST_OFFSET:
        offset = math.copysign(LARGEST_OFFSET, offset)
        heating = (hr - offset * hs) / hh
    return heating, offset, sum((r - heating * h - offset * s) ** 2 for h, s, r in rows) / n


def smallest(function, low, high):
    """Where a function is smallest, on a grid and then between its neighbours (golden section)."""
    grid = [low * (high / low) ** (i / 60) for i in range(61)]
    best = min(range(61), key=lambda i: function(grid[i]))
    a, b = grid[max(best - 1, 0)], grid[min(best + 1, 60)]
    golden = (math.sqrt(5) - 1) / 2
    for _ in range(80):
        c, d = b - golden * (b - a), a + golden * (b - a)
        a, b = (a, d) if function(c) < function(d) else (c, b)
    return (a + b) / 2


def reduced(model, output, power, nominal, outdoor, minutes, horizon):
    """The room of one state that goes best along with a served model."""
    hours, steps = minutes / 60, max(2, round(horizon * 60 / minutes))
    outputs = [one["channel"] for one in model["outputs"]]
    if output not in outputs:
        raise Unusable(f"{model['model']} has no output {output}; it has {', '.join(outputs)}")
    is_held, at = place(model, outdoor)
    now = model["steps"][0]["held" if is_held else "moving"][at]
    courses = [
        (shares, weather, course(model, outputs.index(output), power, nominal, outdoor, shares, weather))
        for shares in schedules(steps, hours)
        for weather in outdoors(steps, hours, now)
    ]
    # From a room that keeps its warmth for two months to one that loses it within a step.
    cooling = smallest(lambda cooling: fitted(cooling, hours, courses)[2], 1 / 1440, 0.999 / hours)
    heating, offset, squared = fitted(cooling, hours, courses)
    return {
        "thermal_config": {
            "heating_rate": abs(heating),
            "cooling_constant": cooling,
            "start_temperature": courses[0][2][0],
            "sense": "heat" if heating >= 0 else "cool",
        },
        "outdoor_offset": offset,
        "rmse": math.sqrt(squared),
        "model": model["model"],
        "revision": model["revision"],
        "exact_everywhere": model["constant"],
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("url", help="address of the service")
    parser.add_argument("system", help="such as room/4")
    parser.add_argument("--power", required=True, help="the input that EMHASS's load drives, such as P_heater")
    parser.add_argument("--nominal", type=float, required=True, help="its value at the nominal power of the load, in the unit of the channel")
    parser.add_argument("--output", default="T_room")
    parser.add_argument("--outdoor", default="T_out")
    parser.add_argument("--step", type=int, default=30, help="EMHASS's optimization_time_step, in minutes")
    parser.add_argument("--horizon", type=float, default=24, help="hours that are planned")
    parser.add_argument("--per-step", action="store_true", help="cooling_constant per step, for EMHASS up to 0.13")
    asked = parser.parse_args()
    try:
        model = linearisation(asked.url.rstrip("/"), asked.system, asked.step)
        found = reduced(model, asked.output, asked.power, asked.nominal, asked.outdoor, asked.step, asked.horizon)
    except (Unusable, OSError) as error:
        print(f"thermal_config: {error}", file=sys.stderr)
        return 1
    if asked.per_step:
        found["thermal_config"]["cooling_constant"] *= asked.step / 60
    print(json.dumps(found, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
