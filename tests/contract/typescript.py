"""A client in TypeScript, whose types are made from the published description, reads what the service answers.

Its compiler is as strict as it can be, and gets answers of the service as literals: a type that no answer fits, or
that nothing can be, is an error.
"""

import json
import shutil
import subprocess
import urllib.parse
from pathlib import Path

import service

SOURCES = Path(__file__).resolve().parent / "typescript"
FILES = ("package.json", "package-lock.json", "tsconfig.json", "client.ts")


def answers(base, fit, diagnosis):
    """Answers as constants of the types that they are described by."""
    models = [(row["id"], "/models/{id}") for row in service.ask(base, "GET", "/models?page_size=200")["items"]]
    lines = ["import type { paths } from './api.js';"]
    for number, (id, path) in enumerate([*models, (fit, "/fits/{id}"), (diagnosis, "/diagnoses/{id}"), ("", f"/params/{service.SYSTEM}")]):
        told = service.ask(base, "GET", path.replace("{id}", urllib.parse.quote(id)))
        if not id:
            path = "/params/{kind}/{id}"
        described = f"paths['{path}']['get']['responses'][200]['content']['application/json']"
        lines.append(f"export const answer{number}: {described} = {json.dumps(told)};")
    return "\n".join(lines)


def walk(base, folder, ids):
    """Makes the types, compiles the client beside the answers, and runs it; gives what went wrong."""
    made = folder / "typescript"
    made.mkdir()
    for name in FILES:
        shutil.copy(SOURCES / name, made)
    fit, diagnosis = ids["fits"][0], ids["diagnoses"][0]
    (made / "answers.ts").write_text(answers(base, fit, diagnosis))
    steps = [
        ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error"],
        ["npx", "--no-install", "openapi-typescript", service.ROOT / "openapi.yaml", "--output", "api.d.ts"],
        ["npx", "--no-install", "tsc", "--project", "."],
        ["node", "built/client.js", base, service.SYSTEM, fit, diagnosis],
    ]
    for step in steps:
        told = subprocess.run(step, cwd=made, stdin=subprocess.DEVNULL, capture_output=True, text=True)
        if told.returncode != 0:
            return f"{' '.join(map(str, step))}: {told.returncode}\n{(told.stdout + told.stderr)[-4000:]}"
    print(told.stdout.strip())
    return None
