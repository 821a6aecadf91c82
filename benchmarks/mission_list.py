"""Measures response times of the list of missions with very many missions.

    python -m benchmarks.mission_list [--missions 5000] [--repeat 20]

Fills a temporary library with missions of three tracks, five objects and a photo each, one in ten of them in
the bin, and requests addresses like a browser, without a network. Prints one JSON object with the median, the
95th percentile and the processor time of a response, milliseconds, and its size: for the page itself, a first
and a middle part of the list, searches with many, few and no results, the bin, and the whole list without and
with previews.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sqlalchemy import insert

from benchmarks.answers import reader, timed
from webapp.missions.store.schema import Mission, MissionObject, MissionPhoto, Track
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import Library, open_library

_BEGIN = datetime(2026, 1, 1, tzinfo=UTC)
_PAGE = 50


def main() -> None:
    """Measure and print one JSON object."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        settings = Settings(library=Path(folder) / "maps")
        library = open_library(settings.library)
        _fill(library, arguments.missions)
        with library.database.write() as session:
            owner = accounts.ensure_owner(session)
        get = reader(library, settings, owner)
        list_ = "/api/v1/missions"
        middle = get(f"{list_}?limit={arguments.missions // 2}").json["next"]
        addresses = {
            "page": "/missions",
            f"first_{_PAGE}": f"{list_}?limit={_PAGE}",
            f"middle_{_PAGE}": f"{list_}?limit={_PAGE}&after={middle}",
            "search_many": f"{list_}?limit={_PAGE}&search=patrol&previews=true",
            "search_few": f"{list_}?limit={_PAGE}&search=4711&previews=true",
            "search_none": f"{list_}?limit={_PAGE}&search=%C5%BEleb&previews=true",
            f"bin_{_PAGE}": f"{list_}?bin=true&limit={_PAGE}",
            "all": list_,
            "all_drawn": f"{list_}?previews=true",
        }
        figures = {name: timed(get, [address] * arguments.repeat) for name, address in addresses.items()}
        library.database.close()
    print(json.dumps({"missions": arguments.missions, **figures}, indent=2))


def _fill(library: Library, count: int) -> None:
    ids = range(1, count + 1)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session).id
        session.execute(insert(Mission), [_mission(id, owner) for id in ids])
        names = [(id, source) for id in ids for source in ("gps", "odometry", "fused")]
        more = {"poses": 6000, "distance_m": 900.0, "first_time_s": 1.7e9, "last_time_s": 1.7e9 + 600}
        session.execute(insert(Track), [{"mission_id": id, "source": source, **more} for id, source in names])
        place = {"lat": 50.0, "lon": 14.0, "first_time_s": 1.7e9, "last_time_s": 1.7e9}
        objects = [
            {"mission_id": id, "object_id": f"o{n}", "kind": "car", **place} for id in ids for n in range(5)
        ]
        session.execute(insert(MissionObject), objects)
        photo = {"name": "a.jpg", "path": "a.jpg", "width": 1, "height": 1, "size_bytes": 1}
        session.execute(
            insert(MissionPhoto), [{"mission_id": id, "sha256": f"{id:064x}", **photo} for id in ids]
        )


def _mission(id: int, owner: int) -> dict[str, object]:
    at = _BEGIN + timedelta(minutes=id * 7919 % 100_000)
    return {
        "id": id,
        "name": f"Patrol {id}",
        "account_id": owner,
        "changed_at": at,
        "binned_at": at if id % 10 == 0 else None,
    }


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--missions", type=int, default=5000)
    parser.add_argument("--repeat", type=int, default=20)
    return parser.parse_args()


if __name__ == "__main__":
    main()
