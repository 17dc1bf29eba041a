"""What stands in contrib/ against a running service: every name that it uses is served, and every template reads an answer.

    contrib.py ADDRESS

The service must have been prepared by `service.seed`. Runs in an environment with pyyaml, jinja2, influxdb and
influxdb-client.
"""

import gzip
import importlib.util
import json
import logging
import math
import re
import sys
import tomllib
import urllib.request
from datetime import datetime, timezone

import influxdb
import influxdb_client
import jinja2
import service
import yaml
from influxdb_client.client.write_api import SYNCHRONOUS

CONTRIB = service.ROOT / "contrib"
# What Prometheus itself says of a target.
FOREIGN_METRICS = {"up"}
HISTOGRAM = re.compile(r"_(bucket|sum|count)$")
METRIC = re.compile(r"\b(?:lampyris|http|process)_[a-z_]+\b|\bup\b(?=\{)")
FUNCTION_OF_HA = {"states": lambda entity: "1500", "state_attr": lambda entity, name: 3.5, "has_value": lambda entity: True, "now": lambda: datetime.now(timezone.utc)}


def text(base, path):
    with urllib.request.urlopen(base + path) as answer:
        return answer.read().decode()


def expressions(document):
    """Every expression of a dashboard or of rules."""
    if isinstance(document, dict):
        for name, value in document.items():
            if name in ("expr", "query") and isinstance(value, str):
                yield value
            yield from expressions(value)
    elif isinstance(document, list):
        for value in document:
            yield from expressions(value)


def metrics(base):
    """Names that the dashboard and the rules use, and that the service does not have."""
    kinds = dict(re.findall(r"^# TYPE (\S+) (\S+)$", text(base, "/metrics"), re.M))
    parts = ("_bucket", "_sum", "_count")
    served = {name + part for name, kind in kinds.items() for part in (parts if kind == "histogram" else ("",))} | FOREIGN_METRICS
    found = []
    for file, read in (("grafana/dashboard.json", json.loads), ("prometheus/alerts.yml", yaml.safe_load)):
        used = {name for expression in expressions(read((CONTRIB / file).read_text())) for name in METRIC.findall(expression)}
        if len(used) < 10:
            found.append(f"{file}: only {sorted(used)} were found")
        found += [f"{file}: {name} is served by nobody" for name in sorted(used - served)]
    documented = set(re.findall(r"^\| `([a-z_]+)` \|", (service.ROOT / "docs/reference/metrics.md").read_text(), re.M))
    return found + [f"docs/reference/metrics.md does not know {name}" for name in sorted(set(kinds) - documented)]


class HomeAssistant(yaml.SafeLoader):
    """YAML with the tags of Home Assistant."""


HomeAssistant.add_constructor("!secret", lambda loader, node: f"secret {node.value}")


def rendered(template, **names):
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, extensions=["jinja2.ext.loopcontrols"])
    environment.filters["float"] = lambda value, default=None: float(value)
    return environment.from_string(template).render(FUNCTION_OF_HA | names)


def home_assistant(base):
    """The package: its sensors read answers, its commands are taken."""
    package = yaml.load((CONTRIB / "home-assistant/lampyris.yaml").read_text(), HomeAssistant)
    room, found = "room/living_room", []
    for resource in package["rest"]:
        path = resource["resource"].removeprefix("http://127.0.0.1:8080").replace(room, service.SYSTEM)
        answer = json.loads(text(base, path))
        for sensor in resource["sensor"]:
            value = rendered(sensor["value_template"].replace(room, service.SYSTEM), value_json=answer)
            if value in ("", "None", "none"):
                found.append(f"{sensor['name']} reads {value!r} of {path}")
            found += [f"{sensor['name']}: {path} has no {name}" for name in sensor.get("json_attributes", []) if name not in answer]
    state = json.loads(text(base, f"/systems/{service.SYSTEM}/state"))
    # The weather is told by the hour, and the newest measurement lies somewhere between.
    start = datetime.fromisoformat(state["at"]).timestamp()
    hourly = [{"datetime": datetime.fromtimestamp(start + 3600 * hour + 2400, timezone.utc).isoformat(), "temperature": 4.0} for hour in range(8)]
    asked = {"system": service.SYSTEM, "hours": 6, "outdoor": hourly, "power_kw": 1.5, "reason": "guests"}
    answers = {}
    for name, command in package["rest_command"].items():
        path = rendered(command["url"], **asked).removeprefix("http://127.0.0.1:8080")
        answers[name] = service.ask(base, command["method"].upper(), path, json.loads(rendered(command["payload"], **asked)))
    service.ended(base, answers["lampyris_estimate"]["id"])
    urllib.request.urlopen(urllib.request.Request(f"{base}/params/{service.SYSTEM}/pin", method="DELETE"))
    forecast = next(part for part in package["template"] if "actions" in part)
    for sensor in forecast["sensor"]:
        answer = {"status": 200, "content": answers["lampyris_forecast"]}
        for template in (sensor["state"], sensor["availability"], *sensor["attributes"].values()):
            if rendered(template, answer=answer) in ("", "None", "False"):
                found.append(f"{sensor['name']}: {template} reads nothing")
    # What is sampled is what is included, and what is included has a rule.
    sampled = [sensor["name"] for part in package["template"] if "actions" not in part for sensor in part["sensor"]]
    rules = service.ask(base, "PUT", "/sources/influx", json.loads((CONTRIB / "home-assistant/rules.json").read_text()))["rules"]
    for name in sampled:
        patterns = [rule["tags"]["entity_id"].replace("{room}", "(.+)") for rule in rules]
        if sum(bool(re.fullmatch(pattern, name)) for pattern in patterns) != 1:
            found.append(f"{name} has not one rule: {patterns}")
    return found


def line_protocol(base):
    """The client libraries of InfluxDB write, as Home Assistant and Telegraf do."""
    logging.getLogger("influxdb_client").setLevel(logging.CRITICAL)
    rule = {"measurement": "room", "tags": {"name": "{name}"}, "field": "temperature", "system": "room/{name}", "channel": "T_room"}
    service.ask(base, "PUT", "/sources/influx", {"rules": [rule]})
    service.ask(base, "PUT", "/systems/room/pushed", {"model": "rc1"})
    start = datetime(2026, 1, 5, tzinfo=timezone.utc)

    def point(minute, value):
        at = datetime.fromtimestamp(start.timestamp() + 60 * minute, timezone.utc)
        return {"measurement": "room", "tags": {"name": "pushed"}, "time": at, "fields": {"temperature": value, "note": "a, \"b\""}}

    host, port = base.removeprefix("http://").split(":")
    first = influxdb.InfluxDBClient(host=host, port=int(port), username="any", password="any", database="any", gzip=True)
    found = [] if "lampyris" in first.ping() else ["influxdb: nobody answers a ping"]
    first.write_points([])
    first.write_points([point(0, 20.0), point(1, 20.5)])
    first.close()
    with influxdb_client.InfluxDBClient(url=base, token="any", org="any", enable_gzip=True) as second:
        if not second.ping():
            found.append("influxdb_client: nobody answers a ping")
        writer = second.write_api(write_options=SYNCHRONOUS)
        writer.write(bucket="any", record=b"")
        writer.write(bucket="any", record=[point(2, 21.0)])
        writer.write(bucket="any", record="room,name=pushed temperature=21.5 1767571380", write_precision="s")
        try:
            writer.write(bucket="any", record="room,name=pushed temperature")
            found.append("influxdb_client: a line without a value is taken")
        except influxdb_client.rest.ApiException as refused:
            if refused.status != 400 or json.loads(refused.body)["code"] != "invalid" or "line 1" not in str(refused.body):
                found.append(f"influxdb_client: {refused.status} {refused.body}")
    # Telegraf, by its own configuration.
    telegraf = tomllib.loads((CONTRIB / "telegraf/lampyris.conf").read_text())["outputs"]["influxdb_v2"][0]
    body = gzip.compress(b"room,host=gateway,name=pushed temperature=22 1767571440000000000\n")
    headers = {"Content-Encoding": telegraf["content_encoding"], "Content-Type": "text/plain; charset=utf-8", "Authorization": "Token any"}
    place = f"{base}/api/v2/write?bucket={telegraf['bucket']}&org={telegraf['organization']}"
    urllib.request.urlopen(urllib.request.Request(place, body, headers, method="POST"))
    series = service.ask(base, "GET", "/systems/room/pushed/series?channels=T_room")
    values = series["channels"]["T_room"]["values"]
    if values != [20.0, 20.5, 21.0, 21.5, 22.0]:
        found.append(f"what was written reads {values} of {series}")
    return found


def emhass(base):
    """The room of one state: exact for a model of one state, and near one that has more."""
    spec = importlib.util.spec_from_file_location("thermal_config", CONTRIB / "emhass/thermal_config.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    loss, gain, sun, hours = 0.08, 1.5, 0.3, 0.5
    kept = math.exp(-loss * hours)
    grown = (1 - kept) / loss
    model = {
        "model": "one state", "revision": 1, "constant": True,
        "outputs": [{"channel": "T_room"}], "held": [{"channel": "P_heater"}], "moving": [{"channel": "T_out"}],
        "steps": [{
            "states": [20.0], "held": [0.0], "moving": [3.0], "moving_next": [3.0], "offset": [sun * grown], "output_offset": [0.0],
            "a": [[kept]], "b": [[gain / 2 * grown]], "e": [[loss * grown]], "e_next": [[0.0]], "c": [[1.0]], "d_held": [[0.0]], "d_moving": [[0.0]],
        }],
    }
    made = script.reduced(model, "T_room", "P_heater", 2.0, "T_out", 30, 24)
    config = made["thermal_config"]
    wanted = {"heating_rate": gain * grown / hours, "cooling_constant": loss * grown / hours}
    found = [f"EMHASS: {name} is {config[name]} instead of {value}" for name, value in wanted.items() if abs(config[name] / value - 1) > 1e-6]
    if abs(made["outdoor_offset"] - sun / loss) > 1e-6 or made["rmse"] > 1e-9:
        found.append(f"EMHASS: {made}")
    served = script.linearisation(base, service.SYSTEM, 30)
    made = script.reduced(served, "T_room", "P_heater", 20.0, "T_out", 30, 24)
    # What the heater can do within a day: the one state must tell most of it.
    weather = [served["steps"][0]["moving"][0]] * 49
    off, on = (script.course(served, 0, "P_heater", 20.0, "T_out", [share] * 48, weather)[-1] for share in (0.0, 1.0))
    print(f"EMHASS: {made['thermal_config']}, offset {made['outdoor_offset']:.1f} K, rmse {made['rmse']:.3f} K beside {on - off:.2f} K of the heater")
    if not made["rmse"] < 0.1 * (on - off) or made["thermal_config"]["sense"] != "heat":
        found.append(f"EMHASS: {made} beside {on - off} K of the heater")
    return found


def main():
    base = sys.argv[1]
    found = [line for check in (metrics, home_assistant, line_protocol, emhass) for line in check(base)]
    print(*found, sep="\n")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
