"""The example controllers against the built service: what they follow, and what they do without an answer.

    controllers.py FOLDER

Runs in an environment with httpx and do-mpc. Starts services of its own, one after the other, on one database.
"""

import contextlib
import http.server
import json
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
# The largest power of the heating channel of the demo's house, in a unit that nobody knows.
LARGEST = 150.0


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


def controls(folder):
    """do-mpc with live parameters: a new revision changes what is decided."""
    from mpc import NAMES, Controller

    hours = 25
    forecast = {"T_out": [3.0] * hours, "irradiance": [0.0] * hours, "price": [0.3] * hours, "lowest": [0.0] * hours}
    with service.running(folder) as base:
        service.ask(base, "PUT", f"/systems/{SYSTEM}", HOUSE)
        service.ask(base, "POST", f"/systems/{SYSTEM}/windows", service.MEASUREMENTS.read_bytes(), "text/csv")
        service.estimated(base, SYSTEM)
        parameters = Parameters(base, SYSTEM, BASELINE)
        parameters.poll()
        live = Live(parameters)
        state = service.ask(base, "GET", f"/systems/{SYSTEM}/state")
        room = state["T_r"]
        forecast["lowest"] = [room] * hours
        controller = Controller(live, LARGEST)
        first = controller.decide(state, forecast)
        # Colder outside, more power; free to cool, next to none.
        colder = controller.decide(state, forecast | {"T_out": [-7.0] * hours})
        idle = controller.decide(state, forecast | {"lowest": [room - 8.0] * hours})
        if not (0.0 <= first < colder <= LARGEST and idle < 0.1 * first):
            raise AssertionError(f"{first} at 3 degC, {colder} at -7, {idle} where it may cool")
        again = controller.decide(state, forecast)
        expect(abs(again - first) < 2e-4 * first, True, f"the same question again: {again} beside {first}")

        before = {name: live.values[name] for name in NAMES}
        refitted(base, parameters, "alpha_a", 1.3)
        expect(abs(controller.decide(state, forecast) - again) < 2e-4 * first, True, "before the poll")
        expect((parameters.poll(), parameters.revision), ("new", 2), "another revision")
        after = {name: live.values[name] for name in NAMES}
        expect(abs(after["alpha_a"] / before["alpha_a"] - 1.3) < 1e-9, True, "the held parameter")
        changed = controller.decide(state, forecast)
        # The other parameters were fitted to the same measurements and make up for most of it.
        if abs(changed - again) < 1e-3 * first:
            raise AssertionError(f"revision 2 changed nothing: {again} and {changed}")
        # Not to be trusted: warmer than was asked for.
        live.is_trusted = False
        if not controller.decide(state, forecast) > changed:
            raise AssertionError("no caution")
        print(f"do-mpc: {again:.2f} under revision 1, {changed:.2f} under revision 2")


class Live:
    """The followed set; this house measures no sun, and its model has none."""

    def __init__(self, parameters):
        self._parameters = parameters
        self.is_trusted = True

    @property
    def values(self):
        return {"c_solar": 0.0} | self._parameters.values

    def trusted(self):
        return self.is_trusted and self._parameters.trusted()


def main():
    folder = Path(sys.argv[1])
    for check in (keeps, follows, controls):
        own = folder / check.__name__
        own.mkdir()
        check(own)
        print(f"controllers: {check.__name__} passed")


if __name__ == "__main__":
    main()
