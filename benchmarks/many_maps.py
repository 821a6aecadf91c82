"""Measures response times of a library with very many maps and photos, on PostgreSQL and on SQLite.

    python -m benchmarks.many_maps [--maps 10000] [--photos 1000000] [--repeat 40] [--only postgresql]

Fills a library with maps that have equally many photos, all placed; a tenth of the maps are shared with a
guest who owns none. Then requests addresses like a browser, without a network: the first page of the list, a
page in the middle, searches with many, few and no results, the same as JSON, and the editor with all that it
needs to open, each time for another map.

Prints a JSON object: for each address and database median, 95th percentile and processor time of a response,
milliseconds, and its size. The exit code is 1 if a 95th percentile is over `--most` milliseconds.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import insert, text

from benchmarks.answers import reader, timed
from tests.postgresql_server import PostgresqlServer
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import Library, open_library
from webapp.store.schema import Account, MapRecord, Member, Photo

_BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
_PAGE = 48
_ROWS = 20_000
"""Number of rows per INSERT."""


def main() -> int:
    """Measure all databases; return 1 if a response takes too long."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--maps", type=int, default=10_000)
    parser.add_argument("--photos", type=int, default=1_000_000)
    parser.add_argument("--repeat", type=int, default=40)
    parser.add_argument("--most", type=float, default=300.0)
    parser.add_argument("--only", choices=["postgresql", "sqlite"])
    asked = parser.parse_args()
    figures = {}
    for kind in ("postgresql", "sqlite"):
        if asked.only in (None, kind):
            with _database(kind) as url, tempfile.TemporaryDirectory() as folder:
                figures[kind] = measure(Path(folder) / "maps", url, asked)
    print(json.dumps({"maps": asked.maps, "photos": asked.photos, **figures}, indent=1))
    return int(any(one["p95_ms"] > asked.most for of in figures.values() for one in of.values()))


@contextmanager
def _database(kind: str) -> Iterator[str | None]:
    """Create an empty database and yield its URL; None stands for SQLite."""
    if kind == "sqlite":
        yield None
        return
    server = PostgresqlServer()
    try:
        yield server.new_database(empty=True)
    finally:
        server.remove()


def measure(folder: Path, url: str | None, asked: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Fill a library and measure requests."""
    library = open_library(folder, url=url)
    settings = Settings(library=folder, database=url)
    owner, guest = fill(library, maps=asked.maps, photos=asked.photos)
    figures = {}
    for who, account in (("owner", owner), ("guest", guest)):
        get = reader(library, settings, account)
        list_ = "/api/v1/maps"
        middle = get(f"{list_}?limit={asked.maps // 20}").json["next"]
        addresses = {
            "list": "/",
            "list, middle": f"/?after={middle}",
            "search, many": "/?search=survey",
            "search, few": "/?search=4711",
            "search, none": "/?search=%C5%BEleb",
            "as JSON": f"{list_}?limit={_PAGE}",
            "search as JSON": f"{list_}?limit={_PAGE}&search=survey%2099",
        }
        for name, address in addresses.items():
            figures[f"{who}: {name}"] = timed(get, [address] * asked.repeat)
        shared = [10 * (n + 1) for n in range(asked.repeat)]  # a guest sees every tenth
        figures[f"{who}: editor"] = timed(get, [f"/maps/survey-{n}/edit" for n in shared])
        figures[f"{who}: editor as JSON"] = timed(get, [f"{list_}/survey-{n}" for n in shared])
    library.database.close()
    return figures


def fill(library: Library, *, maps: int, photos: int) -> tuple[Account, Account]:
    """Fill a library; return its owner, and a guest who sees a tenth of the maps."""
    each = photos // maps
    place = np.random.default_rng(1)
    with library.database.write() as session:
        owner, guest = accounts.ensure_owner(session), accounts.create(session, "guest")
        ids = range(1, maps + 1)
        session.execute(insert(MapRecord), [_map(id, each) for id in ids])
        session.execute(insert(Member), [_member(id, owner, "owner") for id in ids])
        session.execute(insert(Member), [_member(id, guest, "viewer") for id in ids if id % 10 == 0])
    for begin in range(0, photos, _ROWS):
        some = range(begin, min(begin + _ROWS, each * maps))
        spots = place.uniform(0, 2000, (len(some), 2))
        rows = [_photo(number, each, spot) for number, spot in zip(some, spots.tolist(), strict=True)]
        with library.database.write() as session:
            session.execute(insert(Photo), rows)
    if library.database.engine.dialect.name == "postgresql":
        with library.database.engine.connect() as connection:  # as autovacuum does within minutes
            connection.execution_options(isolation_level="AUTOCOMMIT").execute(text("ANALYZE"))
    return owner, guest


def _map(id: int, photos: int) -> dict[str, Any]:
    return {
        "id": id,
        "slug": f"survey-{id}",
        "name": f"Survey {id}",
        "changed_at": _BEGIN + timedelta(minutes=id * 7919 % 100_003),
        "satellite_path": "satellite.png",
        "satellite_width": 2000,
        "satellite_height": 2000,
        "next_id": photos,
        "revision": photos,
    }


def _member(id: int, account: Account, role: str) -> dict[str, Any]:
    return {"map_id": id, "account_id": account.id, "role": role}


def _photo(number: int, each: int, spot: list[float]) -> dict[str, Any]:
    map_, id = divmod(number, each)
    return {
        "map_id": map_ + 1,
        "id": id,
        "name": f"DSC{id:05}.jpg",
        "path": f"photos/DSC{id:05}.jpg",
        "sha256": hashlib.sha256(str(number).encode()).hexdigest(),
        "size_bytes": 3_000_000,
        "width": 4000,
        "height": 3000,
        "x_px": spot[0],
        "y_px": spot[1],
        "revision": id,
    }


if __name__ == "__main__":
    sys.exit(main())
