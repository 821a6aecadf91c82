"""The cluster of `chaos` as its clients see it, and all these clients."""

from __future__ import annotations

import argparse
import hashlib
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.chaos_library import Made
from benchmarks.chaos_load import (
    Localizer,
    PatientClient,
    PatientRobot,
    Refusals,
    UnsureEditor,
    Uploader,
    noise_photo,
)
from benchmarks.client import Client
from webapp.store.library import Library, open_library

_MAPS = 2
_PHOTOS = 30
_PLAN_PX = (1600, 1200)
_LOCALIZED = 12
_STEP_PX = 300


@dataclass(frozen=True)
class Site:
    """Addresses and storage of the cluster.

    Attributes:
    ----------
    address : str
        Address for clients.
    folder : Path
        Folder of the library.
    database : str
        URL of the database.
    storage : str or None
        URL of the object storage of photos, unless they are in the folder.
    """

    address: str
    folder: Path
    database: str
    storage: str | None

    def library(self) -> Library:
        """Open the library; the caller must close it."""
        return open_library(self.folder, url=self.database)


@dataclass
class Load:
    """All clients of the cluster."""

    editors: list[UnsureEditor]
    uploaders: list[Uploader]
    robots: list[PatientRobot]
    localizers: list[Localizer]
    refusals: Refusals

    def work(self, arguments: argparse.Namespace) -> None:
        """Run all clients in parallel for the given time."""
        seconds = 60 * arguments.minutes
        options = argparse.Namespace(seconds=seconds, hertz=5.0, beat=1.0)
        begin = time.time() + 1.0
        people = (*self.editors, *self.uploaders, *self.localizers)
        threads = [threading.Thread(target=one.work, args=(seconds,)) for one in people]
        threads += [threading.Thread(target=robot.work, args=(begin, options)) for robot in self.robots]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def people(arguments: argparse.Namespace) -> int:
    """Count the accounts that the clients and an owner need."""
    return 1 + int(arguments.editors + arguments.uploaders + arguments.localizing)


def set_up(site: Site, arguments: argparse.Namespace, *, made: Made) -> tuple[Load, dict[str, Any]]:
    """Make maps with photos of noise; return the clients and the state of the edited maps."""
    links = [site.address + path for path in made.links]
    owner = Client(site.address, links[0])
    plan = site.folder.with_name("plan.png")
    cv2.imwrite(str(plan), np.full((_PLAN_PX[1], _PLAN_PX[0], 3), 200, np.uint8))
    draw = np.random.default_rng(arguments.seed)
    photos = [site.folder.with_name(f"{number}.jpg") for number in range(_PHOTOS)]
    for path in photos:
        cv2.imwrite(str(path), draw.integers(0, 255, (120, 160, 3), np.uint8))
    edited = [owner.make_map(f"Edited {n}", satellite=plan, photos=photos) for n in range(_MAPS)]
    indexed, queries = _indexed_map(owner, plan, draw=draw)
    filled = [
        indexed,  # so that the index that is searched changes all the time
        *(owner.make_map(f"Filled {n}", satellite=plan, photos=[]) for n in range(1, arguments.uploaders)),
    ]
    refusals = Refusals()
    clients = iter([PatientClient(site.address, link, refusals) for link in links[1:]])
    editors = [
        UnsureEditor(next(clients), edited[n % _MAPS], seed=n, pause_s=arguments.pause)
        for n in range(arguments.editors)
    ]
    uploaders = [
        Uploader(next(clients), filled[n], seed=1000 + n, pause_s=5.0) for n in range(arguments.uploaders)
    ]
    for one in uploaders[:1]:
        one.tried |= {hashlib.sha256(data).hexdigest() for data, _, _ in queries}
    localizers = [Localizer(client, indexed, queries, pause_s=arguments.pause) for client in clients]
    robots = [PatientRobot(site.address, made.token, id, refusals=refusals) for id in made.missions]
    load = Load(editors, uploaders, robots, localizers, refusals)
    first = {slug: owner.ask("GET", f"/maps/{slug}") for slug in edited}
    return load, first


def _indexed_map(
    owner: Client, plan: Path, *, draw: np.random.Generator
) -> tuple[str, list[tuple[bytes, float, float]]]:
    """Make a map whose photos are placed and indexed; return its slug, and its photos with their places."""
    data = [noise_photo(draw) for _ in range(_LOCALIZED)]
    paths = [plan.with_name(f"placed-{n}.jpg") for n in range(_LOCALIZED)]
    for path, content in zip(paths, data, strict=True):
        path.write_bytes(content)
    slug = owner.make_map("Localized", satellite=plan, photos=paths)
    columns = _PLAN_PX[0] // _STEP_PX
    places = [(_STEP_PX * (n % columns + 0.5), _STEP_PX * (n // columns + 0.5)) for n in range(_LOCALIZED)]
    state = owner.ask("GET", f"/maps/{slug}")
    changes = [
        {"id": photo["id"], "x_px": x, "y_px": y}
        for photo, (x, y) in zip(sorted(state["photos"], key=lambda one: one["id"]), places, strict=True)
    ]
    edit = {"seen": state["revision"], "kind": "place", "changes": changes}
    owner.ask("PATCH", f"/maps/{slug}/experiences", json=edit)
    while any(job["state"] != "done" for job in owner.ask("GET", f"/jobs?map={slug}")["jobs"]):
        time.sleep(1.0)
    return slug, [(content, x, y) for content, (x, y) in zip(data, places, strict=True)]
