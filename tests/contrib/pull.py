"""The service fetches its own metrics back from a real Prometheus, as live samples of a site.

    pull.py PROMETHEUS LAMPYRIS

Both are programs. Everything is on loopback, in a scratch folder, and ends with this script.
"""

import json
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

PATIENCE_S = 90


def free_port():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def ask(base, method, path, body=None):
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(base + path, data=data, method=method, headers={"content-type": "application/json"})
    with urllib.request.urlopen(request, timeout=10) as answer:
        return json.load(answer)


def main():
    prometheus, lampyris = sys.argv[1:]
    started = []
    with tempfile.TemporaryDirectory() as folder:
        try:
            command = [lampyris, "serve", "--bind", "127.0.0.1:0", "--database", f"{folder}/pull.db"]
            service = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
            started.append(service)
            base = service.stdout.readline().strip().rsplit(" ", 1)[-1]
            config = Path(folder, "prometheus.yml")
            config.write_text(
                "scrape_configs:\n- job_name: lampyris\n  scrape_interval: 1s\n  scrape_timeout: 1s\n"
                f"  static_configs:\n  - targets: ['{base.removeprefix('http://')}']\n"
            )
            port = free_port()
            command = [prometheus, f"--config.file={config}", f"--storage.tsdb.path={folder}/data", f"--web.listen-address=127.0.0.1:{port}"]
            started.append(subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
            ask(base, "PUT", "/systems/site/home", {})
            source = {
                "url": f"http://127.0.0.1:{port}",
                "queries": ['up{job="lampyris"}', "lampyris_workers"],
                "every": "PT10S",
                "step": "PT1S",
                "lookback": "PT30S",
                "rules": [{"measurement": "up", "tags": {"job": "{job}"}, "system": "site/home", "channel": "{job}_up", "unit": "-"}],
            }
            ask(base, "PUT", "/sources/prometheus", source)
            begun = time.monotonic()
            while time.monotonic() - begun < PATIENCE_S:
                state = ask(base, "GET", "/sources/prometheus")
                if state["taken"] > 5 and not state["latest"]["error"]:
                    break
                time.sleep(1)
            assert state["taken"] > 5 and state["latest"]["error"] is None, state
            series = ask(base, "GET", "/systems/site/home/series?channels=lampyris_up")["channels"]["lampyris_up"]
            assert series["samples"] > 5 and set(series["values"]) <= {1.0, 0.0, None}, series
            print(f"{state['taken']} values in {time.monotonic() - begun:.0f} s")
        finally:
            for one in started:
                one.kill()
                one.wait()


main()
