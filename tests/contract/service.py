"""Runs the built service for the checks of its contract, and gives it something to talk about.

Nothing but the standard library, so that it can be used before anything is installed.
"""

import contextlib
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TARGET = ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
# The system that exists while the contract is checked, and of which the examples speak: a real house, with
# measurements, a fit and parameters.
SYSTEM = "room/4"
MODEL = "tite"
COLUMNS = {"T_room": "T_indoor_degC", "T_out": "T_outdoor_degC", "P_heater": "heat_input_raw"}
MEASUREMENTS = ROOT / "config/demo/hourly_house.csv"
ESTIMATE = {"kind": "estimate", "system": SYSTEM, "method": {"name": "lm_multistart", "seed": 1}, "budget": {"evaluations": 4000}}
PATIENCE_S = 600


def binary():
    """The program that is checked: the one that LAMPYRIS_BINARY names, or the release build."""
    return Path(os.environ.get("LAMPYRIS_BINARY", TARGET / "release/lampyris"))


def environment(*packages):
    """A Python of its own with these packages, kept beside what is built; gives the folder of its programs."""
    name = hashlib.sha256(" ".join([sys.version, *packages]).encode()).hexdigest()[:16]
    programs = TARGET.resolve() / "python" / name / "bin"
    whole = programs.parent / "whole"
    if not whole.exists():
        venv.create(programs.parent, clear=True, with_pip=True)
        subprocess.run([programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages], check=True)
        whole.touch()
    return programs


@contextlib.contextmanager
def running(folder, port=0, **settings):
    """A service on a free port of the loopback, or this one, with the database of the folder; ends with the block."""
    # A step that is stopped must end what it started, so the signal becomes an exception.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    log = Path(folder) / "service.log"
    command = [binary(), "serve", "--bind", f"127.0.0.1:{port}", "--database", Path(folder) / "contract.db"]
    with log.open("w") as log_file:
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log_file, text=True, env={**os.environ, **settings})
    try:
        line = child.stdout.readline()
        if "listening on " not in line:
            raise RuntimeError(f"the service does not listen:\n{log.read_text()}")
        yield line.split("listening on ")[1].strip()
        if child.poll() is not None:
            raise RuntimeError(f"the service ended with {child.returncode}:\n{log.read_text()[-4000:]}")
    finally:
        child.terminate()
        try:
            child.wait(60)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


def token(folder):
    """A token for everything; from here on the services of this folder answer nobody without one."""
    command = [binary(), "token", "create", "--name", "contract", "--scope", "admin", "--json", "--database", Path(folder) / "contract.db"]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["token"]


def ask(base, method, path, body=None, media_type="application/json"):
    """The JSON answer to a request, which must succeed."""
    data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
    headers = {} if data is None else {"Content-Type": media_type}
    try:
        with urllib.request.urlopen(urllib.request.Request(base + path, data, headers, method=method), timeout=PATIENCE_S) as answer:
            return json.load(answer)
    except urllib.error.HTTPError as error:
        raise RuntimeError(f"{method} {path}: {error.code} {error.read().decode()}") from None


def ended(base, job):
    """A job after its end."""
    begun = time.monotonic()
    while (answer := ask(base, "GET", f"/jobs/{job}"))["state"] not in ("succeeded", "failed", "cancelled"):
        if time.monotonic() - begun > PATIENCE_S:
            raise RuntimeError(f"job {job} does not end: {answer}")
        time.sleep(0.1)
    return answer


def promoted(base, job):
    """Says an operator's word on the fit of a job."""
    ask(base, "POST", f"/fits/{job['fit']}/promote", {"reason": "for the contract"})


def quiet(base):
    """Waits until no job waits or runs."""
    for state in ("queued", "running"):
        for job in ask(base, "GET", f"/jobs?state={state}")["items"]:
            ended(base, job["id"])


def estimated(base, system, **more):
    """The fit of an estimate, whose outcome must be one of those that a service may want to show."""
    job = ended(base, ask(base, "POST", "/jobs", ESTIMATE | {"system": system} | more)["id"])
    if job["outcome"] not in ("accepted", "suggested"):
        raise RuntimeError(f"{system} has no parameters: {job}")
    return job


def seed(base):
    """Makes some of each thing; gives their ids by the first part of the paths that lead to them.

    What an example may use up is named by its operation.
    """
    house = {"label": "A house", "model": MODEL, "channels": COLUMNS}
    measured = MEASUREMENTS.read_bytes()
    ask(base, "PUT", f"/systems/{SYSTEM}", house)
    window = ask(base, "POST", f"/systems/{SYSTEM}/windows", measured, "text/csv")
    ahead = {"time": ["2020-01-24T23:00:00Z", "2020-01-26T00:00:00Z"], "values": {"T_out": [6.4, 4.8], "P_heater": [15, 15]}}
    ask(base, "POST", f"/systems/{SYSTEM}/windows", ahead | {"roles": {name: "forecast" for name in ahead["values"]}})
    jobs = [estimated(base, SYSTEM), estimated(base, SYSTEM, method={"name": "lm_multistart", "seed": 2}, experiment=True)]
    found = [ended(base, ask(base, "POST", "/jobs", ESTIMATE | {"kind": kind})["id"]) for kind in ("diagnose", "ladder")]
    version = ask(base, "POST", f"/models/{MODEL}/effects", {"effect": "constant_gain"})
    batch = ask(base, "POST", "/jobs", {"kind": "recalibrate", "systems": [SYSTEM], "budget": {"evaluations": 100}})
    ask(base, "PUT", "/schedules/weekly", {"cron": "0 5 * * 1", "systems": ["plant/*"]})
    # A house whose fits wait for an operator, one with a window that nothing cites, and one to be deleted.
    ask(base, "PUT", "/systems/room/asks", house | {"policy": {"mode": "suggest"}})
    ask(base, "POST", "/systems/room/asks/windows", measured, "text/csv")
    asks = [estimated(base, "room/asks", method={"name": "lm_multistart", "seed": seed}) for seed in (1, 2)]
    ask(base, "PUT", "/systems/room/guest", {"model": "rc1"})
    uncited = ask(
        base,
        "POST",
        "/systems/room/guest/windows",
        {"time": ["2026-01-01T00:00:00Z", "2026-01-01T01:00:00Z"], "values": {"T_room": [20, 21]}},
    )
    ask(base, "PUT", "/systems/room/spare", house)
    # A job that has been called off may be called off again; one that has come to its result may not.
    slow = {"method": {"name": "cfa_thesis", "generations": 100_000}, "budget": {"evaluations": 100_000_000}, "experiment": True}
    called_off = ask(base, "POST", "/jobs", ESTIMATE | {"system": SYSTEM} | slow)
    ask(base, "POST", f"/jobs/{called_off['id']}/cancel")
    ended(base, called_off["id"])
    return {
        "batches": [batch["id"]],
        "nights": [batch["id"]],
        "diagnoses": [found[0]["diagnosis"]],
        "effects": ["constant_gain", "metered_gain"],
        "fits": [job["fit"] for job in jobs],
        "jobs": [job["id"] for job in jobs],
        "models": [MODEL, version["id"]],
        "schedules": ["nightly"],
        "windows": [window["id"]],
        "cancel_job": {"id": called_off["id"]},
        "delete_window": {"id": uncited["id"]},
        "promote_fit": {"id": asks[0]["fit"]},
        "reject_fit": {"id": asks[1]["fit"]},
    }
