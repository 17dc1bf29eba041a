"""Every operation has examples: what is sent is taken, and what is answered has the form that is described.

    examples.py ADDRESS IDS

The ids are those of a service that `service.seed` has prepared.
"""

import json
import sys
import threading
import urllib.error
import urllib.parse
import urllib.request

import jsonschema_rs
import service

METHODS = ("get", "post", "put", "delete")
PATIENCE_S = 600
# Paths that change or remove something have something of their own; the others show the house.
PATHS = {
    "put_system": {"id": "spare"},
    "delete_system": {"id": "spare"},
    "post_window": {"id": "guest"},
    "post_samples": {"id": "guest"},
    "put_schedule": {"name": "weekly"},
    "delete_schedule": {"name": "weekly"},
    "get_docs_file": {"name": "docs.js"},
    "post_model_effect": {"id": service.MODEL},
}
QUERIES = {"get_comparison": "max_points=2", "get_compare": "fits={fits}&max_points=2", "get_series": "max_points=10", "write_lines": "precision=s"}
STREAM = "text/event-stream"


class Problem(Exception):
    """An example, or the answer to one, that is not as the description says."""


def operations(description):
    """Path, method and operation; readers first, and what removes things last."""
    found = [(path, method, item[method]) for path, item in description["paths"].items() for method in METHODS if method in item]
    return sorted(found, key=lambda one: METHODS.index(one[1]))


def address(path, operation, ids):
    """The path and query of an operation, for things that exist."""
    kind, name = service.SYSTEM.split("/")
    collection = path.split("/")[1]
    wanted = operation["operationId"]
    values = {"kind": kind, "id": name, "name": "nightly"}
    if collection in ids:
        values["id"] = ids[collection][0]
    values |= PATHS.get(wanted, {}) | ids.get(wanted, {})
    query = QUERIES.get(wanted, "").format(fits=",".join(ids["fits"][:2]))
    return path.format(**{name: urllib.parse.quote(value) for name, value in values.items()}) + ("?" + query if query else "")


def requests(operation):
    """Media type and text of each example of a body; one without a body where the operation takes none."""
    content = operation.get("requestBody", {}).get("content", {})
    if not content:
        return [(None, None)]
    found = []
    for media_type, body in content.items():
        for example in body.get("examples", {}).values():
            value = example["value"]
            found.append((media_type, value if isinstance(value, str) else json.dumps(value)))
    if not found:
        raise Problem("no example of a body")
    return found


def answers(operation):
    """Media type to (schema, example) of the answers to a success."""
    found = {}
    for status, response in operation["responses"].items():
        if status.startswith("2"):
            for media_type, content in response.get("content", {}).items():
                if "example" not in content:
                    raise Problem(f"no example of the answer {status} {media_type}")
                found.setdefault(media_type, []).append((content["schema"], content["example"]))
    return found


def events(text):
    """The events of a stream, as the description writes one down."""
    for block in text.split("\n\n"):
        fields = [line.split(": ", 1) for line in block.splitlines() if ": " in line]
        event = dict(field for field in fields if field[0] in ("event", "id", "data"))
        if "event" in event:
            yield event


def parsed(media_type, text):
    """An answer in the form that its schema speaks of."""
    return json.loads(text) if media_type == "application/json" else text


def closed(schema):
    """A schema that allows no field that it does not name."""
    if isinstance(schema, list):
        return [closed(part) for part in schema]
    if not isinstance(schema, dict):
        return schema
    made = {name: part if name in ("example", "examples", "enum", "default") else closed(part) for name, part in schema.items()}
    if isinstance(made.get("properties"), dict) and made.get("type") == "object":
        made.setdefault("additionalProperties", False)
    return made


def disagreements(description, schema, media_type, text):
    """Where a text disagrees with its schema."""
    validator = jsonschema_rs.Draft202012Validator(closed(schema | {"components": {"schemas": description["components"]["schemas"]}}))
    values = list(events(text)) if media_type == STREAM and "$ref" in schema else [parsed(media_type, text)]
    if not values:
        return ["nothing was told"]
    return [f"{error.instance_path}: {error.message[:300]}" for value in values for error in validator.iter_errors(value)]


def read(answer, begun=""):
    """The text of an answer; of a stream that does not end, its first event."""
    if not (answer.headers["Content-Type"] or "").startswith(STREAM):
        return answer.read().decode()
    text = begun
    for line in answer:
        text += line.decode()
        if text.endswith("\n\n") and any(events(text)):
            break
    return text


def send(base, method, place, media_type, body, accept):
    """Status, media type and text of an answer."""
    headers = {"Accept": accept} | ({"Content-Type": media_type} if media_type else {})
    data = None if body is None else body.encode()
    with urllib.request.urlopen(urllib.request.Request(base + place, data, headers, method=method.upper()), timeout=PATIENCE_S) as answer:
        return answer.status, (answer.headers["Content-Type"] or "").split(";")[0], read(answer)


def exchanges(base, description, ids):
    """Sends every example; gives operation, media type, schemas with examples, and the answer."""
    for path, method, operation in operations(description):
        name = operation["operationId"]
        if method == "delete":
            # What a job may be reading cannot be removed.
            service.quiet(base)
        try:
            expected = answers(operation)
            bodies = requests(operation)
        except Problem as problem:
            yield name, str(problem), None
            continue
        place = address(path, operation, ids)
        for media_type, body in bodies:
            for accept in expected or ("*/*",):
                if name == "get_events":
                    # Something has to happen that is told.
                    threading.Timer(0.5, service.ask, (base, "POST", "/jobs", service.ESTIMATE | {"experiment": True})).start()
                try:
                    status, kind, text = send(base, method, place, media_type, body, accept)
                except urllib.error.HTTPError as error:
                    yield name, f"{method.upper()} {place} {media_type}: {error.code} {error.read().decode()[:600]}", None
                    continue
                yield name, None, (status, kind, text, expected)


def check(base, ids):
    """Checks every operation; gives how many examples were sent, and what was found."""
    description = service.ask(base, "GET", "/openapi.json")
    sent, found = 0, []
    for name, problem, exchange in exchanges(base, description, ids):
        sent += 1
        if problem:
            found.append(f"{name}: {problem}")
            continue
        status, kind, text, expected = exchange
        if kind not in expected:
            if expected or text:
                found.append(f"{name}: answered {status} {kind or 'nothing'}, described are {list(expected)}")
            continue
        for schema, example in expected[kind]:
            shown = example if isinstance(example, str) else json.dumps(example)
            found += [f"{name}: the example of {kind}: {what}" for what in disagreements(description, schema, kind, shown)]
        # One of the described answers is this one.
        all_of_them = [disagreements(description, schema, kind, text) for schema, _ in expected[kind]]
        found += [f"{name}: the answer {status} {kind}: {what}" for what in min(all_of_them, key=len)]
    return sent, sorted(set(found))


if __name__ == "__main__":
    with open(sys.argv[2]) as file:
        sent, found = check(sys.argv[1], json.load(file))
    print(*found, f"{sent} examples were sent, {len(found)} faults found", sep="\n")
    sys.exit(bool(found))
