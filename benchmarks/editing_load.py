"""Simulates many people who edit shared maps: measures response times, and checks for lost edits.

    python -m benchmarks.editing_load [--clients 20] [--seconds 120] [--maps 2] [--photos 40] [--pause 0.3]

Starts the program with a temporary library and maps of small photos. Every client has its own account and
behaves like the edit page: it polls for changes every second, and places, moves, turns, undoes and redoes in
between, based on the newest revision that it knows. Conflicts are valid responses: the client takes over the
new state and continues. Any other status than 2xx is an error.

Nothing is lost if the acknowledged edits have each revision from the first to the last exactly once, and if
replaying them in this order gives the final state of the API, the database and `map.cfg`.

The clients are threads with `requests`, a dependency of folium. Locust would add eighteen packages, including
a second network stack for gevent, and its report does not cover lost edits.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.client import Client
from benchmarks.editing_checks import (
    Final,
    acknowledged,
    check_revisions,
    check_seen,
    differences,
    read_final,
)
from benchmarks.editing_client import Editor, Log
from tests.browser.app import App
from webapp.store.accounts import accounts, sign_in
from webapp.store.library import open_library

PLAN_PX = (1600, 1200)


def main() -> None:
    """Run the load and print one JSON object; exit with 1 if there were problems."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "maps"
        with App(library) as app:
            slugs, editors = _set_up(app, Path(folder), arguments)
            first = {slug: editors[0].client.ask("GET", f"/maps/{slug}") for slug in slugs}
            _work(editors, seconds=arguments.seconds)
            served = {slug: editors[0].client.ask("GET", f"/maps/{slug}") for slug in slugs}
        logs = [editor.log for editor in editors]
        final = {slug: read_final(library, slug) for slug in slugs}
    problems = _problems(first, served, final=final, logs=logs)
    print(json.dumps({**_figures(arguments, logs), "problems": problems}, indent=2))
    raise SystemExit(1 if problems else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--clients", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--maps", type=int, default=2, help="shared by all clients")
    parser.add_argument("--photos", type=int, default=40, help="of a map")
    parser.add_argument("--pause", type=float, default=0.3, help="mean seconds between two edits of a client")
    return parser.parse_args()


def _set_up(app: App, folder: Path, arguments: argparse.Namespace) -> tuple[list[str], list[Editor]]:
    """Make maps with photos of noise, and an account for each client, all of which may edit them."""
    owner = Client(app.url, app.sign_in)
    rng = np.random.default_rng(1)
    plan = folder / "plan.png"
    cv2.imwrite(str(plan), np.full((PLAN_PX[1], PLAN_PX[0], 3), 200, np.uint8))
    photos = [folder / f"{number}.jpg" for number in range(arguments.photos)]
    for path in photos:
        cv2.imwrite(str(path), rng.integers(0, 255, (120, 160, 3), np.uint8))
    slugs = [
        owner.make_map(f"Map {number}", satellite=plan, photos=photos) for number in range(arguments.maps)
    ]
    editors = []
    for number, path in enumerate(sign_in_links(app.library, arguments.clients)):
        client = Client(app.url, app.url + path)
        editors.append(Editor(client, slugs[number % len(slugs)], seed=number, pause_s=arguments.pause))
    return slugs, editors


def sign_in_links(folder: Path, count: int, *, url: str | None = None) -> list[str]:
    """Create accounts with all permissions; return the paths that sign in to them.

    `url` is that of the database, unless it is SQLite.
    """
    library = open_library(folder, url=url)
    with library.database.write() as session:
        people = [accounts.create(session, f"client{number}", is_owner=True) for number in range(count)]
        links = [f"/sign-in/{sign_in.new_link(session, person, hours=1)}" for person in people]
    library.database.close()
    return links


def _work(editors: list[Editor], *, seconds: float) -> None:
    threads = [threading.Thread(target=editor.work, args=(seconds,)) for editor in editors]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def _problems(
    first: dict[str, Any], served: dict[str, Any], *, final: dict[str, Final], logs: list[Log]
) -> list[str]:
    """Return descriptions of all problems."""
    problems = [error for log in logs for error in log.errors]
    for slug, end in final.items():
        answers = [answer for log in logs if log.slug == slug for answer in log.answers]
        problems += check_revisions(answers, first=first[slug]["revision"], last=end.revision)
        problems += check_seen(answers)
        expected = acknowledged(first[slug]["photos"], answers)
        problems += differences(expected, served=served[slug]["photos"], final=end)
    return problems


def _figures(arguments: argparse.Namespace, logs: list[Log]) -> dict[str, Any]:
    edits = np.array([seconds for log in logs for seconds in log.edit_seconds])
    polls = np.array([seconds for log in logs for seconds in log.poll_seconds])
    return {
        "clients": arguments.clients,
        "maps": arguments.maps,
        "seconds": arguments.seconds,
        "edits": sum(len(log.answers) for log in logs),
        "conflicts": sum(log.conflicts for log in logs),
        "errors": sum(len(log.errors) for log in logs),
        "edits_per_second": round(len(edits) / arguments.seconds, 1),
        **_percentiles("edit", edits),
        **_percentiles("changes", polls),
    }


def _percentiles(name: str, seconds: np.ndarray) -> dict[str, float]:
    return {f"{name}_ms_p{q}": round(1000 * float(np.percentile(seconds, q)), 1) for q in (50, 95, 99)}


if __name__ == "__main__":
    main()
