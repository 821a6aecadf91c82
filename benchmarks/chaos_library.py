"""Makes the library of `chaos` with the version of the program that Python finds, and prints what is in it.

python -P benchmarks/chaos_library.py FOLDER DATABASE ROBOTS PEOPLE
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from webapp.missions.store import missions
from webapp.store.accounts import accounts, sign_in
from webapp.store.library import open_library
from webapp.store.maps import maps


@dataclass(frozen=True)
class Made:
    """A token of robots, the numbers of their missions, and paths that sign in to accounts."""

    token: str
    missions: list[int]
    links: list[str]


def make_library(folder: Path, url: str, *, robots: int, people: int) -> Made:
    """Make accounts, missions and a map, since an empty library would get the sample map at the start."""
    library = open_library(folder, url=url)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        maps.create(session, "Another", account_id=owner.id)
        token = accounts.new_token(session, owner, name="robots")
        ids = [missions.create(session, f"Robot {n}", account_id=owner.id).id for n in range(robots)]
        made = [accounts.create(session, f"client{n}", is_owner=True) for n in range(people)]
        links = [f"/sign-in/{sign_in.new_link(session, person, hours=1)}" for person in made]
    library.database.close()
    return Made(token, ids, links)


if __name__ == "__main__":
    folder, url, robots, people = sys.argv[1:]
    print(json.dumps(asdict(make_library(Path(folder), url, robots=int(robots), people=int(people)))))
