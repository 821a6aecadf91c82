"""Simulates a long uptime by very many requests, and checks that the server's resources do not grow.

    python -m benchmarks.uptime [--requests 200000] [--clients 4]

Clients request the state of a map, exports and pictures, move photos and undo that, upload photos that the
map has already, and send invalid requests. Prints a JSON object with samples (memory of all processes of the
server together, open files, size of the database, files of the library, lines of the log) and with the maxima
of the second and of the last quarter of the run. The exit code is 1 if one of them keeps growing, or if a
request fails.
"""

from __future__ import annotations

import argparse
import io
import itertools
import json
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import requests
from PIL import Image

from benchmarks.client import Client
from benchmarks.editing_load import sign_in_links
from benchmarks.memory import family, memory_mb
from tests.browser.app import App

_SLUG = "aged"
_PHOTOS = 12
_SAMPLES = 20
_GROWTH = {"rss_mb": 60.0, "open_files": 20.0, "database_mb": 2.0, "library_files": 50.0, "log_lines": 50.0}
"""An increase by more than this, and by more than a tenth, counts as growth."""


def main() -> None:
    """Run the load and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--requests", type=int, default=200_000)
    parser.add_argument("--clients", type=int, default=4)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, App(Path(folder) / "maps") as app:
        report = _age(app, requests_wanted=arguments.requests, clients=arguments.clients)
    print(json.dumps(report, indent=2))
    raise SystemExit(1 if report["grows"] or report["failures"] else 0)


def _age(app: App, *, requests_wanted: int, clients: int) -> dict[str, Any]:
    ids = _prepare(Client(app.url, app.sign_in))
    numbers = itertools.count()
    failures: list[str] = []
    samples: list[dict[str, float]] = []
    lock = threading.Lock()
    every = max(1, requests_wanted // _SAMPLES)

    def work(link: str) -> None:
        client = Client(app.url, app.url + link)
        while (number := next(numbers)) < requests_wanted:
            try:
                status = _request(client, number, ids=ids)
            except requests.RequestException as error:
                failures.append(f"{number}: {error!r}")
                continue
            if status >= 500:
                failures.append(f"{number}: {status}")
            if number % every == 0:
                with lock:
                    samples.append(_sample(app, number))

    started = time.monotonic()
    with ThreadPoolExecutor(clients) as pool:
        for done in [pool.submit(work, link) for link in sign_in_links(app.library, clients)]:
            done.result()
    seconds = time.monotonic() - started
    samples.append(_sample(app, requests_wanted))
    growth = _growth(sorted(samples, key=lambda sample: sample["requests"]))
    grows = [
        name for name, (before, after) in growth.items() if after - before > max(before / 10, _GROWTH[name])
    ]
    return {
        "requests": requests_wanted,
        "per_second": round(requests_wanted / seconds),
        "failures": failures[:20],
        "samples": samples,
        "growth": growth,
        "grows": grows,
    }


def _prepare(owner: Client) -> list[int]:
    owner.ask("POST", "/maps", json={"name": _SLUG})
    owner.ask("PUT", f"/maps/{_SLUG}/satellite", files={"file": ("plan.png", _noise("PNG", 0))})
    ids = []
    for number in range(_PHOTOS):
        (answer,) = owner.ask(
            "POST", f"/maps/{_SLUG}/photos", files={"file": (f"{number}.jpg", _noise("JPEG", number))}
        )
        ids.append(answer["id"])
    return ids


def _request(client: Client, number: int, *, ids: list[int]) -> int:
    """Send the request of a number; return its status."""
    photo = ids[number % len(ids)]
    where = f"/maps/{_SLUG}"
    match number % 20:
        case 0:
            place = {"x_px": float(number % 400), "y_px": float(number % 300)}
            return client.call("PATCH", f"{where}/experiences/{photo}", json=place).status_code
        case 1:
            return client.call("POST", f"{where}/undo").status_code
        case 2:
            again = {"file": ("again.jpg", _noise("JPEG", number % len(ids)))}
            return client.call("POST", f"{where}/photos", files=again).status_code
        case 3:
            return client.call("GET", f"{where}/photos/{photo}/preview").status_code
        case 4:
            return client.call("GET", f"{where}/export.zip").status_code
        case 5:
            return client.call("GET", f"{where}/photos/999999/preview").status_code
        case 6:
            return client.call("PATCH", f"{where}/experiences/{photo}", json={"x_px": "no"}).status_code
        case remainder if remainder % 2:
            return client.call("GET", where).status_code
        case _:
            return client.call("GET", "/maps").status_code


def _sample(app: App, number: int) -> dict[str, float]:
    inner = app.library / ".library"
    return {
        "requests": number,
        "rss_mb": round(memory_mb(app.pid)["all"]["Pss"], 1),
        "open_files": sum(map(_open_files, family(app.pid))),
        "database_mb": round(sum(path.stat().st_size for path in inner.glob("library.db*")) / 1e6, 2),
        "library_files": sum(1 for path in app.library.rglob("*") if path.is_file()),
        "log_lines": len(app.said),
    }


def _open_files(process: int) -> int:
    try:
        return sum(1 for _ in Path(f"/proc/{process}/fd").iterdir())
    except OSError:
        return 0


def _growth(samples: list[dict[str, float]]) -> dict[str, tuple[float, float]]:
    """Return the maxima of the second and of the last quarter of the run."""
    quarter = len(samples) // 4
    early, late = samples[quarter : 2 * quarter], samples[-quarter:]
    return {
        name: (max(sample[name] for sample in early), max(sample[name] for sample in late))
        for name in _GROWTH
    }


def _noise(kind: str, seed: int) -> bytes:
    file = io.BytesIO()
    pixels = np.random.default_rng(seed).integers(0, 255, (300, 400, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(file, kind)
    return file.getvalue()


if __name__ == "__main__":
    main()
