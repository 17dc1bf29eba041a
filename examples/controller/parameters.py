"""Follows the parameters of one system, as a controller must: it is never without an answer.

    200  use these
    304  keep yours
    404  use your own baseline
    429, 5xx, no answer, or an answer that is no set: keep the last known

Everything else, such as a token that is not accepted, is a mistake of whoever set the controller up. It is told as
`refused`, and the last known set is kept as well: no mistake of that kind may stop the heating.
"""

import json
import os
from datetime import datetime, timezone
from pathlib import Path

import httpx

# What a controller may rely on. The others are used with caution: `stale` is old, `degraded` is contradicted by newer
# measurements, `nominal` was never validated.
TRUSTED = {"fresh", "fallback", "pinned"}
TIMEOUT_S = 5


class Parameters:
    """The newest set of parameters of a system, and how far it may be trusted.

    `baseline` serves until there is something better, and again where the service says that there is nothing. With
    `memory`, a file, the last known set outlives this process.
    """

    def __init__(self, url, system, baseline, token=None, memory=None):
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        self._client = httpx.Client(base_url=url, headers=headers, timeout=TIMEOUT_S)
        self._path = f"/params/{system}"
        self._baseline = {"status": "baseline", "revision": None, "stale_after": None, **baseline}
        self._memory = Path(memory) if memory else None
        self._etag, self._set = self._remembered()
        self.problem = None

    def poll(self, wait_s=0):
        """Asks once; with `wait_s`, the service answers as soon as it has news.

        Gives what came of it: `new`, `kept`, `baseline`, `unreachable` or `refused`. `problem` says why it was none of
        the first two.
        """
        headers = {"If-None-Match": self._etag} if self._etag else {}
        if wait_s:
            headers["Prefer"] = f"wait={wait_s}"
        try:
            answer = self._client.get(self._path, headers=headers, timeout=TIMEOUT_S + wait_s)
            if answer.status_code == 200:
                return self._take(answer)
        except (httpx.HTTPError, ValueError, KeyError, TypeError) as error:
            self.problem = f"{type(error).__name__}: {error}"
            return "unreachable"
        if answer.status_code == 304:
            self.problem = None
            return "kept"
        self.problem = f"{answer.status_code} {_slug(answer)}"
        if answer.status_code == 404:
            self._keep(None, self._baseline)
            return "baseline"
        return "unreachable" if answer.status_code == 429 or answer.status_code >= 500 else "refused"

    @property
    def values(self):
        """The parameters by name."""
        return self._set["parameters"]

    @property
    def model(self):
        return self._set["model"]

    @property
    def revision(self):
        """Counts up with every set that is published; nothing for the baseline."""
        return self._set["revision"]

    @property
    def status(self):
        return self._set["status"]

    def trusted(self, now=None):
        """Whether to rely on the set without more caution than usual.

        Where nobody answers the set ages all the same: it carries its own date.
        """
        end = self._set["stale_after"]
        if self.status not in TRUSTED:
            return False
        return end is None or (now or datetime.now(timezone.utc)) < datetime.fromisoformat(end)

    def _take(self, answer):
        body = answer.json()
        # A set that is not whole is none. A nominal value that only measurements give is null, and so not a number.
        if not all(isinstance(body[field], kind) for field, kind in (("parameters", dict), ("status", str), ("model", str))):
            raise ValueError("the answer is no set of parameters")
        body["revision"], body["stale_after"]
        self._keep(answer.headers.get("ETag"), body)
        self.problem = None
        return "new"

    def _keep(self, etag, body):
        self._etag, self._set = etag, body
        if self._memory:
            # Another file first, then its name: a power cut leaves the old set or the new one.
            draft = self._memory.with_suffix(".draft")
            draft.write_text(json.dumps({"etag": etag, "set": body}))
            os.replace(draft, self._memory)

    def _remembered(self):
        try:
            kept = json.loads(self._memory.read_text())
            return kept["etag"], kept["set"]
        except (AttributeError, OSError, ValueError, KeyError):
            return None, self._baseline


def _slug(answer):
    """The stable name of a problem (RFC 9457)."""
    try:
        return answer.json()["type"]
    except (ValueError, KeyError, TypeError):
        return answer.reason_phrase
