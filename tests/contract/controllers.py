"""The example controllers against the built service: what they follow, and what they do without an answer.

    controllers.py FOLDER

Runs in an environment with httpx and casadi. Starts services of its own, one after the other, on one database.
"""

import contextlib
import copy
import http.server
import json
import math
import random
import subprocess
import sys
import threading
import time
from datetime import datetime, timedelta, timezone
from pathlib import Path

import service

EXAMPLES = service.ROOT / "examples/controller"
sys.path.insert(0, str(EXAMPLES))

from controller import BASELINE, holding_power  # noqa: E402
from parameters import Parameters  # noqa: E402

SYSTEM = "room/controlled"
# Its measurements end in January 2020, and are to be fresh for three days whenever this runs.
AGE = datetime.now(timezone.utc) - datetime(2020, 1, 24, 23, tzinfo=timezone.utc)
HOUSE = {"model": service.MODEL, "channels": service.COLUMNS, "policy": {"stale_after": f"P{AGE.days + 3}D"}}
# The largest power of the house that is controlled, in kW, and the minutes between two samples.
LARGEST_KW = 4.0
QUARTER = 15


@contextlib.contextmanager
def answering(status, body):
    """A server that always gives this answer: what a live service cannot be asked for."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def expect(found, wanted, what):
    if found != wanted:
        raise AssertionError(f"{what}: {found!r} instead of {wanted!r}")


def refitted(base, parameters, name, factor):
    """Publishes another revision: the same measurements with one parameter held a little off."""
    service.promoted(base, service.estimated(base, SYSTEM, fixed={name: parameters.values[name] * factor}))


def follows(folder):
    """The follower through a life: nothing known, a set, news, age, a restart, a deletion."""
    memory = folder / "set.json"
    with service.running(folder) as base:
        parameters = Parameters(base, SYSTEM, BASELINE, memory=memory)
        expect(parameters.poll(), "baseline", "a system that nobody knows")
        expect((parameters.problem, parameters.values), ("404 system-not-found", BASELINE["parameters"]), "the baseline")
        service.ask(base, "PUT", f"/systems/{SYSTEM}", HOUSE)
        expect((parameters.poll(), parameters.problem), ("baseline", "404 no-validated-parameters"), "before any fit")
        expect(parameters.trusted(), False, "trust in a baseline")
        service.ask(base, "POST", f"/systems/{SYSTEM}/windows", service.MEASUREMENTS.read_bytes(), "text/csv")
        service.estimated(base, SYSTEM)
        expect((parameters.poll(), parameters.revision, parameters.status), ("new", 1, "fresh"), "the first set")
        served = service.ask(base, "GET", f"/params/{SYSTEM}")
        expect(parameters.values, served["parameters"], "the values")
        expect((parameters.poll(), parameters.poll(1), parameters.trusted()), ("kept", "kept", True), "a set that has not changed")

        # A poll that waits has the news as soon as there is any.
        told = []
        waiting = threading.Thread(target=lambda: told.append(parameters.poll(30)))
        waiting.start()
        first = dict(parameters.values)
        refitted(base, parameters, "alpha_a", 1.05)
        waiting.join(30)
        expect((told, parameters.revision), (["new"], 2), "news during a poll that waits")
        expect(abs(parameters.values["alpha_a"] / first["alpha_a"] - 1.05) < 1e-9, True, "the held parameter")

        # Old: still served and still used, with caution.
        service.ask(base, "PUT", f"/systems/{SYSTEM}", HOUSE | {"policy": {"stale_after": "PT1S"}})
        begun = time.monotonic()
        while parameters.status != "stale" and time.monotonic() - begun < service.PATIENCE_S:
            parameters.poll(5)
        expect((parameters.status, parameters.revision, parameters.trusted()), ("stale", 2, False), "an old set")
        service.ask(base, "PUT", f"/systems/{SYSTEM}", HOUSE)
        parameters.poll(5)
        expect((parameters.status, parameters.trusted()), ("fresh", True), "the same set under a longer policy")
        port = int(base.rsplit(":", 1)[1])
    expect(parameters.poll(), "unreachable", "a service that is down")
    expect((parameters.revision, parameters.status), (2, "fresh"), "what is kept meanwhile")
    later = datetime.now(timezone.utc) + timedelta(days=30)
    expect((parameters.trusted(), parameters.trusted(later)), (True, False), "a kept set that ages by its own date")
    # The controller is restarted as well, while nobody answers.
    again = Parameters(base, SYSTEM, BASELINE, memory=memory)
    expect((again.revision, again.poll(), again.values), (2, "unreachable", parameters.values), "a controller that starts alone")
    with service.running(folder, port=port) as base:
        expect((parameters.poll(), again.poll()), ("kept", "kept"), "the same tag after a restart of the service")
        printed = subprocess.run(
            [sys.executable, EXAMPLES / "controller.py", base, SYSTEM, "--polls", "2", "--wait", "0"],
            check=True,
            capture_output=True,
            text=True,
        ).stdout.splitlines()
        power = holding_power(parameters.values, 21.0, 5.0)
        line = f"revision 2, fresh: 21.0 degC, power {power:.3f}"
        expect(printed, [f"new: {line}", f"kept: {line}"], "what the controller prints")
        guarded = Parameters(base, SYSTEM, BASELINE)
        guarded.poll()
        service.ask(base, "PUT", "/systems/room/other", HOUSE)
        expect(Parameters(base, "room/other", BASELINE).poll(), "baseline", "another system without a fit")
    # Once there are tokens, one that is not accepted is a mistake, and the set stays.
    service.token(folder)
    with service.running(folder, port=port) as base:
        expect((guarded.poll(), guarded.revision), ("refused", 2), "a service that wants a token")


def keeps(folder):
    """Answers that no set of parameters is to be taken from."""
    memory = folder / "kept.json"
    held = {"status": "fresh", "revision": 7, "stale_after": None, "model": "tite", "parameters": {"alpha_e": 0.3}}
    for status, body, wanted in [
        (503, b"{}", "unreachable"),
        (500, b"boom", "unreachable"),
        (429, b"{}", "unreachable"),
        (200, b'{"status": "fre', "unreachable"),
        (200, b'{"status": "fresh", "model": "tite", "parameters": null}', "unreachable"),
        (200, b"[]", "unreachable"),
        (403, b'{"type": "forbidden"}', "refused"),
        (404, b'{"type": "no-validated-parameters"}', "baseline"),
        (200, json.dumps(held | {"revision": 8}).encode(), "new"),
    ]:
        memory.write_text(json.dumps({"etag": '"seven"', "set": held}))
        with answering(status, body) as url:
            parameters = Parameters(url, SYSTEM, BASELINE, memory=memory)
            expect(parameters.poll(), wanted, f"{status} {body!r}")
            revision = {"new": 8, "baseline": None}.get(wanted, 7)
            expect(parameters.revision, revision, f"the set after {status} {body!r}")


class House:
    """The truth: room air, a heater and an envelope in steps of a minute, with noise of its own."""

    def __init__(self, seed):
        self._random = random.Random(seed)
        self.room, self.heater, self.envelope = 20.5, 21.0, 16.0
        self.minute = 0

    def outdoors(self, minute):
        day = minute / 1440
        return 2.0 + 4.0 * math.sin(2 * math.pi * (day - 0.4)) + 2.5 * math.sin(2 * math.pi * day / 3.7)

    def goes_on(self, power, minutes=QUARTER):
        """The house under a power in kW; gives what the sensor shows then."""
        for _ in range(minutes):
            outdoors = self.outdoors(self.minute)
            room = 1.5 * (self.heater - self.room) + 0.35 * (self.envelope - self.room) + self._random.gauss(0, 0.3)
            heater = 10.0 * (self.room - self.heater) + 10.0 * power
            envelope = 0.06 * (self.room - self.envelope) + 0.03 * (outdoors - self.envelope)
            self.room, self.heater, self.envelope = self.room + room / 60, self.heater + heater / 60, self.envelope + envelope / 60
            self.minute += 1
        return self.room + self._random.gauss(0, 0.03)


def stamp(minute):
    return (datetime(2026, 1, 5, tzinfo=timezone.utc) + timedelta(minutes=minute)).strftime("%Y-%m-%dT%H:%M:%SZ")


def comfort(minute):
    """The lowest temperature: warm by day, cooler at night."""
    return 21.0 if 6 * 60 <= minute % 1440 < 22 * 60 else 18.0


def tariff(minute):
    """The price of a step at the largest power: dear in the evening."""
    return 0.6 if 16 * 60 <= minute % 1440 < 21 * 60 else 0.2


def recorded(days):
    """What a house shows under a thermostat that somebody tries other powers with: rows and the house as it is then."""
    house, random_power = House(1), random.Random(2)
    shown, rows = house.room, []
    for _ in range(days * 96):
        wanted = comfort(house.minute) + 0.5
        power = LARGEST_KW * min(1.0, max(0.0, 0.4 * (wanted - shown) + random_power.choice([0.0, 0.1, 0.3])))
        rows.append((stamp(house.minute), shown, house.outdoors(house.minute), power))
        shown = house.goes_on(power)
    return rows, house, shown


def closed_loop(house, shown, decide):
    """Two days under a controller: what was paid, and the kelvin-hours below the lowest temperature."""
    house = copy.deepcopy(house)
    paid, cold, end = 0.0, 0.0, house.minute + 2 * 1440
    while house.minute < end:
        power = decide(house, shown)
        paid += tariff(house.minute) * power / LARGEST_KW
        shown = house.goes_on(power)
        cold += max(0.0, comfort(house.minute) - house.room) * QUARTER / 60
    return paid, cold


def thermostat(lead, band):
    """On below a set point and off above it; it looks so many minutes ahead in the timetable."""
    heats = False

    def decide(house, shown):
        nonlocal heats
        wanted = max(comfort(house.minute), comfort(house.minute + lead))
        heats = shown < wanted + (band if heats else 0.0)
        return LARGEST_KW if heats else 0.0

    return decide


def controls(folder):
    """Two days of a house under MPC by the service's matrices, beside the best of many thermostats."""
    import mpc

    system = "room/predicted"
    rows, house, shown = recorded(14)
    with service.running(folder) as base:

        def upload(rows):
            time_of, room, outdoors, power = zip(*rows)
            values = {"T_room": room, "T_out": outdoors, "P_heater": power}
            service.ask(base, "POST", f"/systems/{system}/windows", {"time": time_of, "values": values})

        service.ask(base, "PUT", f"/systems/{system}", {"model": "rc2_heater"})
        upload(rows)
        asked = {"kind": "estimate", "system": system, "method": {"name": "lm_multistart", "seed": 1}, "budget": {"evaluations": 8000}}
        job = service.ended(base, service.ask(base, "POST", "/jobs", asked)["id"])
        expect(job["outcome"], "accepted", f"the fit of the house: {job}")
        controller = mpc.Controller(base, system, "P_heater", LARGEST_KW)
        last, followed, spent = [rows[-1]], [], []

        def decide(house, shown):
            ahead = [house.minute + QUARTER * k for k in range(97)]
            if house.minute % 60 == 0:
                # The newest samples, and those before them, which the service has already.
                upload([*last, (stamp(house.minute), shown, house.outdoors(house.minute), last[-1][3])])
                begun = time.monotonic()
                inputs = {"T_out": [house.outdoors(minute) for minute in ahead]}
                power = controller.decide([stamp(minute) for minute in ahead], inputs, *zip(*((tariff(m), comfort(m) + 0.1) for m in ahead[:-1])))
                spent.append(time.monotonic() - begun)
                expect(controller.problem, None, "the answer of the service")
                followed.append(controller.follows)
                last.clear()
            else:
                power = controller.goes_on()
            last.append((stamp(house.minute), shown, house.outdoors(house.minute), power))
            return power

        paid, cold = closed_loop(house, shown, decide)
        # Another revision, of the two days as well, is followed at the next decision.
        upload(last)
        again = service.ended(base, service.ask(base, "POST", "/jobs", asked | {"method": {"name": "lm_multistart", "seed": 2}})["id"])
        expect(again["outcome"], "accepted", f"the fit after two days: {again}")
        ahead = [house.minute + 2 * 1440 + QUARTER * k for k in range(97)]
        arguments = [stamp(m) for m in ahead], {"T_out": [house.outdoors(m) for m in ahead]}, [0.2] * 96, [20.0] * 96
        controller.decide(*arguments)
        expect(controller.problem, None, "the answer of the service")
        expect((followed[0], controller.follows), (("rc2_heater", 1), ("rc2_heater", 2)), "the revision")
    # Nobody answers: the plan goes on.
    plan = list(controller._plan)
    expect(controller.decide(*arguments), plan[1], "the plan without a service")
    expect(controller.problem is not None, True, "what the controller says of it")
    tuned = {(lead, band): closed_loop(house, shown, thermostat(lead, band)) for lead in range(0, 241, 30) for band in (0.2, 0.4, 0.8)}
    cost = {name: paid + mpc.DISCOMFORT * 4 * cold for name, (paid, cold) in tuned.items()}
    best = min(cost, key=cost.get)
    ours = paid + mpc.DISCOMFORT * 4 * cold
    lines = sum(1 for line in (EXAMPLES / "mpc.py").read_text().splitlines() if line.strip())
    print(
        f"MPC: {paid:.2f} paid, {cold:.2f} Kh too cold; the best of {len(tuned)} thermostats {tuned[best][0]:.2f} and "
        f"{tuned[best][1]:.2f}; {lines} lines, {1000 * max(spent):.0f} ms for the longest decision"
    )
    expect(ours < cost[best], True, f"{ours} beside {cost[best]}")
    expect(lines <= 60, True, f"{lines} lines")


def main():
    folder = Path(sys.argv[1])
    for check in (keeps, follows, controls):
        own = folder / check.__name__
        own.mkdir()
        check(own)
        print(f"controllers: {check.__name__} passed")


if __name__ == "__main__":
    main()
