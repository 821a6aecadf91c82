"""Fuzzes a running server with invalid input, and counts its responses.

    python -m benchmarks.hostile [--minutes 60] [--seed 0] [--clients 4] [--only 12345]

Random requests to all of the API, photos, satellite images, zips, `.cfg` files, GeoPackages, missions, shapes
drawn on them, positions of phones, coordinate systems and decompression bombs (some of whose clients leave
after three seconds) are sent by several clients to a separate server with a temporary library; others open
connections, break the rules of HTTP on them and keep them. Each request is derived from the seed and its
number: `--only` repeats one. Prints a JSON object with the responses by kind and status, the slowest request
of each kind, health check and page with their seconds, and the greatest memory of any process, over what it
took when idle; on standard error each fault as it occurs: a 5xx other than "busy" (503 with `Retry-After`)
and a full disk (507), no response, a response after more than a minute, a health check or page after more
than ten seconds, a process with 700 MB more than when idle, an acknowledged photo that is missing or
different. With faults, the end of the server's log follows, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import dataclasses
import io
import itertools
import json
import random
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import requests
from PIL import Image

from benchmarks import hostile_files, hostile_inputs, hostile_json, hostile_maps, hostile_missions
from benchmarks.client import Client
from benchmarks.editing_load import sign_in_links
from benchmarks.hostile_inputs import Request
from benchmarks.memory import PeakMemory
from tests.browser.app import App

TARGET, KEPT = "target", "kept"
_LONGEST_S, _HEALTH_S = 60.0, 10.0
_LEAVES_S = 3.0
_MOST_MB = 700.0
_LOOK_S = 0.2
_CONNECTS_EVERY_S = 0.5
_MOST_KEPT = 40
_STAGED = "/mission-files"
_MISSION = {"name": "walk"}


@dataclasses.dataclass
class Tally:
    """Counts of the responses, and faults."""

    statuses: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    slowest: dict[str, tuple[float, str]] = dataclasses.field(default_factory=dict)
    faults: list[str] = dataclasses.field(default_factory=list)

    def note(self, kind: str, status: object, *, seconds: float, request: str = "") -> None:
        """Count a response, and keep the slowest of each kind."""
        self.statuses[f"{kind} {status}"] += 1
        self.slowest[kind] = max(self.slowest.get(kind, (0.0, "")), (round(seconds, 2), request))

    def fault(self, text: str) -> None:
        """Record and print a fault."""
        self.faults.append(text)
        print(text, file=sys.stderr, flush=True)


def is_fault(status: int, headers: Any) -> bool:
    """Return whether a response indicates a failure of the server itself."""
    return status >= 500 and status != 507 and not (status == 503 and "Retry-After" in headers)


def make_request(
    seed: int, number: int, *, document: dict[str, Any], known: dict[str, Any]
) -> tuple[str, Request]:
    """Return the kind and the request of a number."""
    chance = random.Random(f"{seed}/{number}")
    kinds: dict[str, Callable[[], Request]] = {
        "json": lambda: hostile_json.json_request(chance, document, known=known),
        "api": lambda: hostile_inputs.api_request(chance, document, known=known),
        "photo": lambda: _form(f"/maps/{TARGET}/photos", hostile_inputs.picture(chance)),
        "localize": lambda: _form(f"/maps/{TARGET}/localize", hostile_inputs.picture(chance)),
        "satellite": lambda: _form(
            f"/maps/{TARGET}/satellite", hostile_inputs.picture(chance), method="PUT", tray="1"
        ),
        "zip": lambda: _form("/maps/import", ("a.zip", hostile_inputs.map_zip(chance)), name="imported"),
        "crowded-zip": lambda: _form(
            "/maps/import", ("a.zip", hostile_maps.crowded_zip(chance)), name="many"
        ),
        "crowded-list": lambda: _form(f"/maps/{TARGET}/positions", hostile_maps.crowded_list(chance)),
        "positions": lambda: _form(f"/maps/{TARGET}/positions", ("a.cfg", hostile_inputs.cfg(chance))),
        "mission": lambda: _form(f"/missions/{known['mission_id']}/imports", hostile_inputs.track(chance)),
        "bomb": lambda: _form(f"/missions/{known['mission_id']}/imports", hostile_files.bomb(chance)),
        "preview": lambda: _form(_STAGED, hostile_files.bomb(chance), leave=chance.choice(("", "1"))),
        "package": lambda: _form(f"/maps/{TARGET}/positions", hostile_missions.package(chance)),
        "drawings": lambda: _form(
            f"/missions/{known['mission_id']}/imports", hostile_missions.drawings_file(chance)
        ),
        "drawing": lambda: hostile_missions.drawing(chance, mission_id=known["mission_id"]),
        "phone": lambda: hostile_missions.phone(chance, token=known["phone"]),
        "crs": lambda: Request("PUT", f"/maps/{TARGET}/georeference", json=_world_file(chance)),
    }
    kind = chance.choices(sorted(kinds), weights=[6 if kind == "api" else 1 for kind in sorted(kinds)])[0]
    return kind, kinds[kind]()


def main() -> None:
    """Send requests and print one JSON object."""
    arguments = _arguments()
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder, App(Path(folder) / "maps") as app:
        owner = Client(app.url, app.sign_in)
        acknowledged = _prepare(owner)
        memory, over = PeakMemory(app.pid), threading.Event()
        watches = [
            *(
                threading.Thread(target=_watch, args=(app.url + path, tally, over), kwargs={"kind": kind})
                for kind, path in (("health", "/healthz"), ("page", "/sign-in"))
            ),
            threading.Thread(target=_keep_connections, args=(app.url, over)),
            threading.Thread(target=_watch_memory, args=(memory, over)),
        ]
        for watch in watches:
            watch.start()
        try:
            sent = _send_all(app, arguments, tally=tally)
        finally:
            over.set()
            for watch in watches:
                watch.join()
        if memory.most_mb > _MOST_MB:
            tally.fault(f"{memory.process} took {memory.most_mb:.0f} MB more than when idle")
        _check_kept(owner, acknowledged, tally=tally)
        if tally.faults:
            sys.stderr.writelines(app.said)
    figures = {
        "slowest_health_s": tally.slowest.get("health", (None, ""))[0],
        "slowest_page_s": tally.slowest.get("page", (None, ""))[0],
        "most_mb_over_idle": round(memory.most_mb),
        "of_process": memory.process,
    }
    print(json.dumps({"sent": sent, "faults": len(tally.faults), **figures, **_sorted(tally)}, indent=2))
    raise SystemExit(1 if tally.faults else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--clients", type=int, default=4)
    parser.add_argument("--only", type=int, metavar="NUMBER", help="send this request and no other")
    return parser.parse_args()


def _prepare(owner: Client) -> dict[int, bytes]:
    """Make the maps; return the photos of the map that is not fuzzed, by id."""
    photos: dict[int, bytes] = {}
    for slug in (KEPT, TARGET):
        assert owner.ask("POST", "/maps", json={"name": slug})["slug"] == slug
        owner.ask("PUT", f"/maps/{slug}/satellite", files={"file": ("plan.png", _noise("PNG", 0))})
    for number in range(10):
        data = _noise("JPEG", number)
        (answer,) = owner.ask("POST", f"/maps/{KEPT}/photos", files={"file": ("a.jpg", data)})
        photos[answer["id"]] = data
    return photos


def _send_all(app: App, arguments: argparse.Namespace, *, tally: Tally) -> int:
    """Send requests from all clients until the time is over; return their number."""
    numbers: Iterator[int] = itertools.count() if arguments.only is None else iter([arguments.only])
    until = time.monotonic() + arguments.minutes * 60
    links = sign_in_links(app.library, arguments.clients)
    sent = itertools.count()

    def work(link: str) -> None:
        client = Client(app.url, app.url + link)
        # the server may close a kept-alive connection just when a request is sent
        client.session.headers["Connection"] = "close"
        document = client.ask("GET", "/openapi.json")
        known = _known(client)
        while time.monotonic() < until and (number := next(numbers, None)) is not None:
            kind, request = make_request(arguments.seed, number, document=document, known=known)
            if KEPT in request.path or "account" in request.path:
                continue
            _send(client, request, tally=tally, name=(kind, number))
            if next(sent) % 50 == 0:
                known = _known(client)

    with ThreadPoolExecutor(len(links)) as pool:
        for finished in [pool.submit(work, link) for link in links]:
            finished.result()  # raises if a client failed
    return next(sent)


def _known(client: Client) -> dict[str, Any]:
    """Recreate what was deleted; return existing values, by the names of parameters."""
    client.call("POST", f"/maps/{TARGET}/restore")
    if client.call("GET", f"/maps/{TARGET}").status_code == 404:
        client.call("POST", "/maps", json={"name": TARGET})
    missions = client.ask("GET", "/missions")["missions"]
    mission = missions[0] if missions else client.ask("POST", "/missions", json=_MISSION)
    phone = _phone_token(client, mission["id"], name=f"phone {threading.get_ident()}")
    return {"slug": TARGET, "mission_id": mission["id"], "token": "none", "job_id": 1, "phone": phone}


def _phone_token(client: Client, mission_id: int, *, name: str) -> str:
    """Make the phone of a client anew; return the token of its link, "none" if the mission was deleted."""
    path = f"/missions/{mission_id}/phones"
    for phone in client.call("GET", path).json().get("phones", []):
        if phone["name"] == name:
            client.call("DELETE", f"{path}/{phone['id']}")
    made = client.call("POST", path, json={"name": name})
    return str(made.json()["url"]).rpartition("/")[2] if made.ok else "none"


def _send(client: Client, request: Request, *, tally: Tally, name: tuple[str, int]) -> None:
    kind, number = name
    where = f"{kind} {number}: {request.method} {request.path[:200]}"
    if request.path == _STAGED and request.files:
        where += f" ({request.files[0][1][0]})"
    options: dict[str, Any] = {"params": request.query}
    if request.files:
        options |= {"files": request.files, "data": request.data}
    elif request.raw is not None:
        options |= {"data": request.raw, "headers": {"Content-Type": "application/json"}}
    elif request.json is not None:
        options["json"] = request.json
    started = time.monotonic()
    try:
        if request.path == _STAGED and request.files:
            answer = _preview(client, *request.files[0][1], leaves=bool(request.data["leave"]))
        else:
            answer = client.call(request.method, request.path, **options)
        if answer is None:
            tally.note(kind, "left", seconds=time.monotonic() - started, request=where)
            return
    except (requests.RequestException, ValueError) as error:
        seconds = time.monotonic() - started
        tally.note(kind, "none", seconds=seconds, request=where)
        if not isinstance(error, ValueError | requests.exceptions.InvalidURL):
            tally.fault(f"{where}: {error!r} after {seconds:.0f} s")
        return
    seconds = time.monotonic() - started
    tally.note(kind, answer.status_code, seconds=seconds, request=where)
    if is_fault(answer.status_code, answer.headers):
        tally.fault(f"{where}: {answer.status_code} {answer.text[:200]}")
    elif seconds > _LONGEST_S:
        tally.fault(f"{where}: answered after {seconds:.0f} s")


def _preview(client: Client, name: str, data: bytes, *, leaves: bool) -> requests.Response | None:
    """Upload a file, ask for its contents, and delete it; None if the client left before the answer."""
    begun = client.call("POST", _STAGED, json={"name": name, "size_bytes": len(data)})
    if not begun.ok:
        return begun
    address = f"{_STAGED}/{begun.json()['id']}"
    sent = client.call("PATCH", address, data=data, headers={"Upload-Offset": "0"})
    if not sent.ok:
        return sent
    try:
        return client.call(
            "POST", f"{address}/contents", json={"name": name}, timeout=_LEAVES_S if leaves else _LONGEST_S
        )
    except requests.exceptions.ReadTimeout:
        if not leaves:
            raise
        return None
    finally:
        client.call("DELETE", address)


def _watch_memory(memory: PeakMemory, over: threading.Event) -> None:
    while not over.wait(_LOOK_S):
        memory.look()


def _watch(url: str, tally: Tally, over: threading.Event, *, kind: str) -> None:
    """Ask for a health check or a page every second."""
    while not over.wait(1.0):
        started = time.monotonic()
        try:
            status: object = requests.get(url, timeout=_HEALTH_S).status_code
        except requests.RequestException as error:
            status = "none"
            tally.fault(f"{kind}: {error!r}")
        tally.note(kind, status, seconds=time.monotonic() - started)


def _keep_connections(url: str, over: threading.Event) -> None:
    """Open a connection now and then, break the rules of HTTP on it, and keep it without reading."""
    address = urlsplit(url)
    kept: collections.deque[socket.socket] = collections.deque()
    for pieces in itertools.cycle(hostile_inputs.CONNECTIONS):
        if over.wait(_CONNECTS_EVERY_S):
            break
        connection = socket.create_connection((str(address.hostname), address.port))
        kept.append(connection)
        with contextlib.suppress(OSError):  # the server may have closed it
            for piece in pieces:
                connection.sendall(piece)
                time.sleep(_LOOK_S)
        if len(kept) > _MOST_KEPT:
            kept.popleft().close()
    for connection in kept:
        connection.close()


def _check_kept(owner: Client, acknowledged: dict[int, bytes], *, tally: Tally) -> None:
    for id, data in acknowledged.items():
        answer = owner.call("GET", f"/maps/{KEPT}/photos/{id}/original")
        if answer.content != data:
            tally.fault(f"the acknowledged photo {id} is lost: {answer.status_code}")


def _form(path: str, file: tuple[str, bytes], *, method: str = "POST", **data: str) -> Request:
    return Request(method, path, files=[("file", file)], data=data)


def _world_file(chance: random.Random) -> dict[str, Any]:
    text = "\n".join(str(chance.choice(hostile_inputs.NUMBERS)) for _ in range(6))
    return {"kind": "worldfile", "worldfile": text, "crs": chance.choice(hostile_inputs.TEXTS)}


def _noise(kind: str, seed: int) -> bytes:
    file = io.BytesIO()
    pixels = np.random.default_rng(seed).integers(0, 255, (300, 400, 3)).astype(np.uint8)
    Image.fromarray(pixels).save(file, kind)
    return file.getvalue()


def _sorted(tally: Tally) -> dict[str, Any]:
    return {
        "answers": dict(sorted(tally.statuses.items())),
        "slowest": {kind: [seconds, request] for kind, (seconds, request) in sorted(tally.slowest.items())},
    }


if __name__ == "__main__":
    main()
