"""Traces two requests through the program: modules involved, calls between them, and time.

    python -m benchmarks.flows [--photos 60,1400] [--repeat 40] [--no-query] [--json OUT]

- query: a photo of the sample is sent to its map (POST .../localize, method `verified`, the answer is kept)
- move N: a photo of a map of N is moved (PATCH .../experiences), with all that is done before the answer

"modules" are those of the program in which a function was called, "crossings" calls from a function of one
module to a function of another, both in the program; resuming a generator counts as a call. Calls through a
library, such as from Flask to a view, are not crossings, and code that runs during imports is left out. Both
are counted in one request, after warm-up requests. Times are from further requests without tracing: median
and minimum wall time, and median CPU time of all threads, which is affected least by other work on the
machine.

The requests go to the application in this process, on a temporary library. Only the command line, the API
and `create_app` are used, so that this script can also trace another version: run it by its path with the
Python of that version's virtual environment. Compare times of two versions only if their runs alternated.
"""

from __future__ import annotations

import argparse
import csv
import importlib
import io
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import piexif
from PIL import Image

PACKAGE = "webapp"
FACTORIES = ("webapp.app.web:create_app", "webapp.web:create_app")
"""Factories of the application, in the current version and in older ones."""

PLAN_PX = (1600, 1200)
PHOTO_PX = (64, 48)
PHOTOS_AT_ONCE = 100
SHOWN_PAIRS = 8

Request = Callable[[], None]


@dataclass(frozen=True, slots=True)
class Flow:
    """Figures of a request.

    Attributes:
    ----------
    name : str
    modules : list of str
        Modules in which a function was called.
    crossings : int
        Number of calls between two of them.
    pairs : list of tuple of str, str and int
        The caller's module, the callee's, and the number of calls, most calls first.
    median_ms, fastest_ms, cpu_ms : float
        Of untraced requests: median and minimum wall time, median CPU time.
    load : float
        Load average of the minute before the timing ended.
    """

    name: str
    modules: list[str]
    crossings: int
    pairs: list[tuple[str, str, int]]
    median_ms: float
    fastest_ms: float
    cpu_ms: float
    load: float


class Program:
    """The application on a new library, with requests to its API as the owner.

    Args:
        library: Folder to be created.
    """

    def __init__(self, library: Path) -> None:
        self._library = library
        token = self.expmap("account", "token", "--name", "flows", "--library", str(library)).strip()
        self._headers = {"Authorization": f"Bearer {token}"}
        settings = importlib.import_module(f"{PACKAGE}.settings").Settings(library=library)
        self._client = _factory()(settings).test_client()

    @staticmethod
    def expmap(*words: str) -> str:
        """Run a command in a separate process; return its output."""
        command = [sys.executable, "-m", PACKAGE, *words]
        return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout

    def ask(self, method: str, path: str, **options: Any) -> Any:
        """Send a request to the API that must succeed; return its JSON."""
        answer = self._client.open(f"/api/v1{path}", method=method, headers=self._headers, **options)
        if not 200 <= answer.status_code < 300:
            raise SystemExit(f"{method} {path}: {answer.status_code} {answer.text[:500]}")
        return answer.json

    def do_jobs(self) -> None:
        """Run all queued jobs."""
        self.expmap("worker", "--once", "--library", str(self._library))

    def make_map(self, name: str, *, plan: bytes, photos: dict[str, bytes], positions: list[str]) -> str:
        """Make a map with its photos placed by a table `name;x;y`; return its slug."""
        slug = self.ask("POST", "/maps", json={"name": name})["slug"]
        self.ask("PUT", f"/maps/{slug}/satellite", data={"file": (io.BytesIO(plan), "plan.png")})
        listed = list(photos.items())
        for first in range(0, len(listed), PHOTOS_AT_ONCE):
            files = [(io.BytesIO(photo), name) for name, photo in listed[first : first + PHOTOS_AT_ONCE]]
            results = self.ask("POST", f"/maps/{slug}/photos", data={"file": files})
            failed = [result for result in results if "error" in result]
            if failed:
                raise SystemExit(f"{failed[0]['name']}: {failed[0]['error']}")
        table = io.BytesIO("\n".join(["name;x;y", *positions, ""]).encode())
        self.ask("POST", f"/maps/{slug}/positions", data={"file": (table, "positions.csv")})
        return str(slug)


def main() -> None:
    """Trace both requests and print a table."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        program = Program(Path(folder) / "maps")
        flows = [
            follow(f"move {photos}", moves(program, photos=photos), repeat=arguments.repeat)
            for photos in arguments.photos
        ]
        if not arguments.no_query:
            flows.append(follow("query", queries(program, Path(folder) / "sample"), repeat=arguments.repeat))
    print(as_text(flows))
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(flow) for flow in flows], indent=2) + "\n", "utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("--photos", type=_numbers, default=[60, 1400], help="of the maps on which a photo is moved")
    add("--repeat", type=int, default=40, help="requests that are timed")
    add("--no-query", action="store_true", help="the moved photo only")
    add("--json", type=Path, help="write all figures there, with the names of the modules")
    return parser.parse_args()


def _numbers(text: str) -> list[int]:
    return [int(part) for part in text.split(",")]


def queries(program: Program, folder: Path) -> Request:
    """Make the sample's map in the library; return a function that localizes its queries in turn."""
    cfg = Path(program.expmap("sample", str(folder)).strip())
    image, *lines = (line.split(";") for line in cfg.read_text("utf-8-sig").splitlines())
    placed = {cfg.parent / path: f"{x};{y}" for _, path, x, y, *_ in lines}
    slug = program.make_map(
        "Sample",
        plan=(cfg.parent / image[0]).read_bytes(),
        photos={path.name: path.read_bytes() for path in placed},
        positions=[f"{path.name};{place}" for path, place in placed.items()],
    )
    program.do_jobs()
    with (cfg.parent / "queries.csv").open(encoding="utf-8-sig", newline="") as file:
        asked = [cfg.parent / line["path"] for line in csv.DictReader(file, delimiter=";")]
    turn = itertools.count()

    def request() -> None:
        path = asked[next(turn) % len(asked)]
        form = {"file": (io.BytesIO(path.read_bytes()), path.name), "method": "verified"}
        program.ask("POST", f"/maps/{slug}/localize", data=form)

    return request


def moves(program: Program, *, photos: int) -> Request:
    """Make a map of tiny photos; return a function that moves one of them, another one each time."""
    width, height = PLAN_PX
    names = [f"{number:05}.jpg" for number in range(photos)]
    places = [(20 + 37 * i % (width - 40), 20 + 53 * i % (height - 40)) for i in range(photos)]
    slug = program.make_map(
        f"Moves {photos}",
        plan=draw_plan(),
        photos={name: draw_photo(number) for number, name in enumerate(names)},
        positions=[f"{name};{x};{y}" for name, (x, y) in zip(names, places, strict=True)],
    )
    state = program.ask("GET", f"/maps/{slug}")
    ids, turn = [photo["id"] for photo in state["photos"]], itertools.count()
    seen = state["revision"]

    def request() -> None:
        nonlocal seen
        number = next(turn)
        place = {"x_px": 30.0 + number % 1000, "y_px": 40.0 + number % 900}
        edit = {"seen": seen, "kind": "move", "changes": [{"id": ids[number * 7 % len(ids)], **place}]}
        seen = program.ask("PATCH", f"/maps/{slug}/experiences", json=edit)["revision"]

    return request


def draw_plan() -> bytes:
    """Return a PNG for the map's image."""
    data = io.BytesIO()
    Image.new("RGB", PLAN_PX, (90, 120, 80)).save(data, "png")
    return data.getvalue()


def draw_photo(number: int) -> bytes:
    """Return a tiny JPEG, different for each number, with the EXIF data of a phone."""
    data = io.BytesIO()
    colour = (number % 256, number // 256 % 256, 100)
    minutes, seconds = divmod(number, 60)
    exif = {
        "Exif": {
            piexif.ExifIFD.DateTimeOriginal: f"2024:05:18 15:{minutes:02}:{seconds:02}",
            piexif.ExifIFD.FocalLengthIn35mmFilm: 27,
        },
        "GPS": {
            piexif.GPSIFD.GPSLatitudeRef: "N",
            piexif.GPSIFD.GPSLatitude: ((50, 1), (12, 1), (37000 + number, 1000)),
            piexif.GPSIFD.GPSLongitudeRef: "E",
            piexif.GPSIFD.GPSLongitude: ((15, 1), (49, 1), (30000 + number, 1000)),
            piexif.GPSIFD.GPSImgDirectionRef: "T",
            piexif.GPSIFD.GPSImgDirection: (number % 360, 1),
        },
    }
    Image.new("RGB", PHOTO_PX, colour).save(data, "jpeg", exif=piexif.dump(exif))
    return data.getvalue()


def follow(name: str, request: Request, *, repeat: int) -> Flow:
    """Send a request several times: to warm up, to trace it, and to time it."""
    for _ in range(3):
        request()
    with traced() as calls:
        request()
    times, cpu_times = [], []
    for _ in range(repeat):
        started, cpu_started = time.perf_counter(), time.process_time()
        request()
        times.append(1000 * (time.perf_counter() - started))
        cpu_times.append(1000 * (time.process_time() - cpu_started))
    pairs = Counter((caller, callee) for caller, callee in calls if caller and caller != callee)
    return Flow(
        name=name,
        modules=sorted({callee for _, callee in calls}),
        crossings=pairs.total(),
        pairs=[(caller, callee, count) for (caller, callee), count in pairs.most_common()],
        median_ms=statistics.median(times),
        fastest_ms=min(times),
        cpu_ms=statistics.median(cpu_times),
        load=os.getloadavg()[0],
    )


@contextmanager
def traced() -> Iterator[list[tuple[str, str]]]:
    """Record the modules of caller and callee of each call into the program, "" for a caller outside it.

    Threads that are started meanwhile are traced, too, but not earlier ones.
    """
    calls: list[tuple[str, str]] = []

    def note(frame: FrameType, event: str, argument: object) -> None:
        if event == "call" and frame.f_code.co_name != "<module>":
            callee = _module(frame)
            if callee:
                calls.append((_module(frame.f_back), callee))

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield calls
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]


def as_text(flows: list[Flow]) -> str:
    """Format the figures as a table."""
    heads = ("modules", "crossings", "median ms", "fastest ms", "CPU ms", "load")
    lines = [" " * 12 + "".join(f"{head:>12}" for head in heads)]
    for flow in flows:
        times = (flow.median_ms, flow.fastest_ms, flow.cpu_ms, flow.load)
        counts = f"{len(flow.modules):>12}{flow.crossings:>12}"
        lines.append(f"{flow.name:<12}{counts}" + "".join(f"{figure:>12.1f}" for figure in times))
    for flow in flows:
        lines.append(f"\n{flow.name}: most crossings")
        lines += [f"{count:>7}  {caller} -> {callee}" for caller, callee, count in flow.pairs[:SHOWN_PAIRS]]
    return "\n".join(lines)


def _module(frame: FrameType | None) -> str:
    """Return the module of a frame if it belongs to the program, else ""."""
    name = "" if frame is None else str(frame.f_globals.get("__name__", ""))
    return name if name == PACKAGE or name.startswith(f"{PACKAGE}.") else ""


def _factory() -> Callable[..., Any]:
    for place in FACTORIES:
        module, name = place.split(":")
        try:
            return getattr(importlib.import_module(module), name)  # type: ignore[no-any-return]
        except (ModuleNotFoundError, AttributeError):
            continue
    raise SystemExit(f"none of these makes the application: {', '.join(FACTORIES)}")


if __name__ == "__main__":
    main()
