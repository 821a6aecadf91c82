"""Measures the time to parse, check and import a line of a `.cfg`, for valid and invalid lines.

    python -m benchmarks.map_files [--lines 300000]

Prints a JSON object with microseconds of processor time per line, by kind of file. The photos do not exist:
the figures show what a small zip with many lines costs a server.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from PIL import Image

from webapp.errors import CfgError
from webapp.files.maps.cfg import parse_cfg
from webapp.progress import Progress
from webapp.settings import ImportLimits, Settings
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.tasks.exchange.import_map import import_map
from webapp.tasks.maps.check_map import check_map

_SIDE = 100


def _fine(i: int) -> str:
    return f"{i};photos/p{i}.jpg;{i % _SIDE};{i // 7 % _SIDE}"


def _swapped(i: int) -> str:
    return f"{i};p{i}.jpg;{150 if i % 2 else 50};{50 if i % 2 else 150}"


KINDS: dict[str, Callable[[int], str]] = {
    "fine": _fine,
    "blank": lambda i: "",
    "swapped": _swapped,
    "outside": lambda i: f"{i};p{i}.jpg;{9 * _SIDE};{9 * _SIDE}",
    "the same id": lambda i: f"7;p{i}.jpg;1;1",
    "no numbers": lambda i: f"a{i};p{i}.jpg;b;c",
    "spaces": lambda i: f" {i} ; p{i}.jpg ; 1 ; 1 ",
}
"""Generator of line i, for each kind of file."""


def cfg_of(kind: str, lines: int) -> bytes:
    """Make a `.cfg` of a kind."""
    text = "\n".join([f"plan.png;{_SIDE};{2 * _SIDE}", *map(KINDS[kind], range(lines))])
    return f"{text}\n".encode()


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--lines", type=int, default=300_000)
    lines = parser.parse_args().lines
    with tempfile.TemporaryDirectory() as folder:
        figures = {kind: dict(_measure(kind, lines, folder=Path(folder))) for kind in KINDS}
    print(json.dumps({"lines": lines, "us_per_line": figures}, indent=2))


def _measure(kind: str, lines: int, *, folder: Path) -> Iterator[tuple[str, float]]:
    data = cfg_of(kind, lines)
    cfg, image = folder / "map.cfg", folder / "plan.png"
    cfg.write_bytes(data)
    Image.new("RGB", (_SIDE, 2 * _SIDE)).save(image)
    yield "parse", _microseconds(lambda: _parsed(data), lines)
    yield "check", _microseconds(lambda: check_map(cfg, settings=Settings(), progress=Progress()), lines)
    if kind == "fine":
        archive = folder / "map.zip"
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as opened:
            opened.write(cfg, "map.cfg")
            opened.write(image, "plan.png")
        yield "import", _microseconds(lambda: _imported(archive, folder / "maps", lines), lines)


def _parsed(data: bytes) -> None:
    with contextlib.suppress(CfgError):  # most kinds are invalid on purpose
        parse_cfg(data)


def _imported(archive: Path, maps: Path, lines: int) -> None:
    library = open_library(maps)
    with library.database.write() as session:
        account_id = accounts.ensure_owner(session).id
    settings = Settings(imports=ImportLimits(max_files=2 * lines))
    import_map(library, archive, account_id=account_id, name="many lines", settings=settings)


def _microseconds(work: Callable[[], Any], lines: int) -> float:
    started = time.process_time()
    work()
    return round((time.process_time() - started) / lines * 1e6, 1)


if __name__ == "__main__":
    main()
