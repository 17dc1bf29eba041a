"""A client that is generated from the description takes a window, runs a job and reads typed parameters.

    client.py ADDRESS

Runs in the environment into which `generated` has installed the client.
"""

import subprocess
import sys
import time
from pathlib import Path

GENERATOR = "openapi-python-client==0.29.1"
# The generator knows no CSV and no YAML by name: one is sent as bytes, the other one read as text.
CONFIG = """
project_name_override: lampyris-client
package_name_override: lampyris_client
content_type_overrides:
  text/csv: application/octet-stream
  application/yaml: text/plain
"""
SYSTEM = ("room", "generated")
PATIENCE_S = 600


def generated(programs, base, folder):
    """Generates the client and installs it; gives what the generator complained of."""
    config = folder / "generator.yaml"
    config.write_text(CONFIG)
    made = folder / "client"
    command = [programs / "openapi-python-client", "generate", "--url", f"{base}/openapi.json", "--config", config]
    # Its last step formats what was written, with a program of this environment.
    path = {"PATH": f"{programs}:/usr/bin:/bin", "HOME": str(folder)}
    told = subprocess.run([*command, "--meta", "setup", "--output-path", made], env=path, capture_output=True, text=True)
    if told.returncode != 0:
        raise RuntimeError(f"no client was generated:\n{told.stdout}{told.stderr}")
    subprocess.run([programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", made], check=True)
    return [line for line in (told.stdout + told.stderr).splitlines() if line.startswith(("WARNING", "ERROR"))]


def house(columns):
    """Measurements of a house whose heating we know: times, and the columns by name."""
    import csv

    import service

    with service.MEASUREMENTS.open() as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    return [row["time"] for row in rows], {channel: [float(row[column]) for row in rows] for channel, column in columns.items()}


def walk(base):
    """A window, a job, its end, the parameters."""
    from datetime import datetime

    import lampyris_client.models as models
    import service
    from lampyris_client import Client
    from lampyris_client.api.jobs import get_job, post_job
    from lampyris_client.api.params import get_params
    from lampyris_client.api.systems import put_system
    from lampyris_client.api.windows import post_window

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
    print(f"the generated client has {len(named)} parameters of {params.model}, revision {params.revision}")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    walk(sys.argv[1])
