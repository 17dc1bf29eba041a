"""A client that is generated from the published description takes a window to parameters, and reads every answer.

    client.py ADDRESS

Runs in the environment into which `generated` has installed the client.
"""

import importlib
import io
import json
import pkgutil
import subprocess
import sys
import time
import tomllib
from datetime import datetime, timedelta
from pathlib import Path

GENERATOR = "openapi-python-client==0.29.1"
# The generator knows no CSV and no YAML by name: one is sent as a file, the other one read as text.
CONFIG = """
project_name_override: lampyris-client
package_name_override: lampyris_client
content_type_overrides:
  text/csv: application/octet-stream
  application/yaml: text/plain
"""
# A fault of this generator: it forgets an import where an operation has two bodies and nothing that may be left out.
UNREADABLE_OPERATIONS = {"propose_layout"}
# Their bodies are lines of text, which the generator does not know; InfluxDB's own clients send them (contrib.py).
OTHER_CLIENTS = {"/write", "/api/v2/write"}
SYSTEM = ("room", "generated")
PATIENCE_S = 600


def generated(programs, folder):
    """Generates the client and installs it; gives what the generator complained of."""
    import service

    config = folder / "generator.yaml"
    config.write_text(CONFIG)
    made = folder / "client"
    command = [programs / "openapi-python-client", "generate", "--path", service.ROOT / "openapi.yaml", "--config", config]
    # Its last step formats what was written, with a program of this environment.
    path = {"PATH": f"{programs}:/usr/bin:/bin", "HOME": str(folder)}
    told = subprocess.run([*command, "--meta", "setup", "--output-path", made], env=path, capture_output=True, text=True)
    if told.returncode != 0:
        raise RuntimeError(f"no client was generated:\n{told.stdout}{told.stderr}")
    subprocess.run([programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", made], check=True)
    complaints = [line for line in (told.stdout + told.stderr).splitlines() if line.startswith(("WARNING", "ERROR"))]
    return [line for line in complaints if not any(f"POST {path} " in line for path in OTHER_CLIENTS)]


def house(columns):
    """Measurements of a house whose heating we know: times, and the columns by name."""
    import csv

    import service

    with service.MEASUREMENTS.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return [row["time"] for row in rows], {channel: [float(row[column]) for row in rows] for channel, column in columns.items()}


def alike(read, told):
    """Whether a client kept all that it was told; instants may be written otherwise."""
    if isinstance(told, dict):
        return isinstance(read, dict) and read.keys() == told.keys() and all(alike(read[key], told[key]) for key in told)
    if isinstance(told, list):
        return isinstance(read, list) and len(read) == len(told) and all(map(alike, read, told))
    if isinstance(told, str) and read != told:
        return datetime.fromisoformat(read) == datetime.fromisoformat(told)
    return read == told


def reads(kind, told):
    """A document as this class reads it, with nothing lost."""
    read = kind.from_dict(told)
    assert alike(read.to_dict(), told), f"{kind.__name__} does not keep {json.dumps(told)[:2000]}"
    return read


def imports():
    """The operations of the client; everything that the generator wrote must be a program."""
    import lampyris_client.api
    import lampyris_client.models

    operations = {}
    for package in (lampyris_client.models, lampyris_client.api):
        for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            name = found.name.rsplit(".", 1)[1]
            if name not in UNREADABLE_OPERATIONS:
                operations[name] = importlib.import_module(found.name)
    return operations


def examples(base):
    """Every example of an answer, as the client reads it; gives how many there are."""
    import lampyris_client.models as models
    import service

    kinds = {name.lower(): kind for name, kind in vars(models).items() if isinstance(kind, type)}
    count = 0
    for item in service.ask(base, "GET", "/openapi.json")["paths"].values():
        for operation in item.values():
            for status, response in operation["responses"].items():
                content = response.get("content", {}).get("application/json", {})
                schema = content.get("schema", {}).get("$ref", "").rsplit("/", 1)[-1]
                kind = kinds.get(schema.replace("_", "").lower())
                if status.startswith("2") and kind is not None:
                    reads(kind, content["example"])
                    count += 1
    return count


def walk(base):
    """A window, a job, its end, the parameters, a fit, a forecast."""
    import lampyris_client.models as models
    import service
    from lampyris_client import Client
    from lampyris_client.api.fits import get_fit
    from lampyris_client.api.jobs import get_job, post_job
    from lampyris_client.api.params import get_params
    from lampyris_client.api.systems import get_state, post_forecast, put_system
    from lampyris_client.api.windows import post_window
    from lampyris_client.types import File

    client = Client(base_url=base, raise_on_unexpected_status=True)
    made = put_system.sync(*SYSTEM, client=client, body=models.System(model=service.MODEL, label="By a generated client"))
    assert isinstance(made, models.SystemAnswer), made
    time_of, values = house(service.COLUMNS)
    columns = models.WindowBodyValues()
    for channel, column in values.items():
        columns[channel] = column
    window = post_window.sync(
        *SYSTEM, client=client, body=models.WindowBody(time=[datetime.fromisoformat(text) for text in time_of], values=columns)
    )
    assert isinstance(window, models.Window) and window.rows == len(time_of), window
    # The same measurements once more, as a file.
    rows = [",".join(["time", *values]), *(",".join(map(str, row)) for row in zip(time_of, *values.values()))]
    file = post_window.sync(*SYSTEM, client=client, body=File(payload=io.BytesIO("\n".join(rows).encode())))
    assert isinstance(file, models.Window) and file.rows == window.rows, file

    asked = models.SystemJob(
        kind=models.SystemJobKind.ESTIMATE,
        system="/".join(SYSTEM),
        method=models.LmMethod.from_dict(service.ESTIMATE["method"]),
        budget=models.Budget.from_dict(service.ESTIMATE["budget"]),
    )
    job = post_job.sync(client=client, body=asked)
    assert isinstance(job, models.Job), job
    begun = time.monotonic()
    while job.state not in (models.JobState.SUCCEEDED, models.JobState.FAILED, models.JobState.CANCELLED):
        assert time.monotonic() - begun < PATIENCE_S, job
        time.sleep(0.1)
        job = get_job.sync(job.id, client=client)
    assert job.outcome == models.Outcome.ACCEPTED, job

    params = get_params.sync(*SYSTEM, client=client)
    assert isinstance(params, models.Params), params
    # The measurements are years old, whenever they were validated.
    assert (params.job, params.fit, params.status) == (job.id, job.fit, models.ParamsStatus.STALE), params
    named = params.parameters.additional_properties
    assert named and all(isinstance(value, float) for value in named.values()), named
    assert set(params.units.additional_properties) == set(named), params.units
    error = params.error["T_room"]
    assert isinstance(error, models.ServedError) and 0 < error.validation_rmse < 2, error
    assert params.validated_at.utcoffset() is not None, params.validated_at
    unknown = get_params.sync("room", "nobody", client=client)
    assert isinstance(unknown, models.Problem) and unknown.status == 404, unknown

    fit = get_fit.sync(params.fit, client=client)
    assert isinstance(fit, models.Fit), fit
    assert {name: entry.value for name, entry in fit.parameters.additional_properties.items()} == named, fit.parameters
    state = get_state.sync(*SYSTEM, client=client)
    assert isinstance(state, models.StateAnswer) and state.revision == params.revision, state
    ahead = models.WindowBodyValues()
    ahead["T_out"], ahead["P_heater"] = [5.0, 4.0], [10.0, 10.0]
    hours = models.WindowBody(time=[state.at, state.at + timedelta(hours=6)], values=ahead)
    forecast = post_forecast.sync(*SYSTEM, client=client, body=models.ForecastRequest(horizon="PT6H", step="PT1H", inputs=hours))
    assert isinstance(forecast, models.SystemForecast), forecast
    assert (forecast.at, forecast.revision, len(forecast.time)) == (state.at, params.revision, 7), forecast
    room = forecast.outputs["T_room"]
    assert len(room.values) == 7 and all(0 < value < 40 for value in room.values), room
    return f"{len(named)} parameters of {params.model}, revision {params.revision}"


def catalogue(base, operations):
    """Every model and effect there is, and every diagnosis; gives how many of each."""
    import lampyris_client.models as models
    import service
    from lampyris_client import Client

    client = Client(base_url=base, raise_on_unexpected_status=True)
    # A plant as its operator writes it.
    document = tomllib.loads((service.ROOT / "config/plants/asm1_n.toml").read_text()) | {"id": "generated"}
    made = operations["post_model"].sync(client=client, body=models.Plant.from_dict(document))
    assert isinstance(made, models.Model) and isinstance(made.document, models.Plant), made
    assert isinstance(made.expanded, models.ModelSpec), made.expanded
    counts = {}
    for noun, kind in (("model", models.Model), ("effect", models.Effect), ("diagnosis", models.Diagnosis)):
        path = "/diagnoses" if noun == "diagnosis" else f"/{noun}s"
        ids = [row["id"] for row in service.ask(base, "GET", f"{path}?page_size=200")["items"]]
        for id in ids:
            assert isinstance(operations[f"get_{noun}"].sync(id, client=client), kind), id
            reads(kind, service.ask(base, "GET", f"{path}/{id}"))
        counts[noun] = len(ids)
    room, plant = (operations["get_model"].sync(id, client=client) for id in ("room3", "bsm1"))
    assert isinstance(room.document, models.ModelSpec) and len(room.document.check) > 3, room.document
    assert len(plant.states) > 100 and isinstance(plant.document, models.ModelSpec), plant.title
    return counts


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    found = imports()
    told = walk(sys.argv[1])
    counts = catalogue(sys.argv[1], found)
    print(f"the generated client has {told}, and reads {examples(sys.argv[1])} examples and {counts}")
