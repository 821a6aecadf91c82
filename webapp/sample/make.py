"""Makes the sample: a small map of a synthetic park, with photos, queries and their ground truth."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from PIL import Image

from webapp.core.geo.fit import Corners, from_corners
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import EnuMetres, LatLon, MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage
from webapp.errors import StorageError, UsageError
from webapp.files.atomic import write_text
from webapp.files.localize.queries_csv import HEADER
from webapp.files.maps.folder import write_map
from webapp.files.photos.exif_write import CameraTags, exif_bytes
from webapp.progress import Progress
from webapp.sample.scene.camera import CameraView, map_views, query_views
from webapp.sample.scene.plan import DEPTH_M, WIDTH_M
from webapp.sample.scene.render import overhead, render
from webapp.sample.scene.stage import AFTERNOON, AUTUMN, EVENING, OVERCAST, Light, Stage, set_stage
from webapp.sample.scene.world import World, build_world
from webapp.settings import Settings

RECORD = "sample.json"
"""File that marks a folder as a sample."""

FOCAL_35MM = 27
FOV_DEG = math.degrees(2 * math.atan(0.4 * math.hypot(36, 24) / FOCAL_35MM))
"""Horizontal, of photos with sides 4:3: the 35 mm equivalent refers to the diagonal."""

ACCURACY_M = 0.1
"""Accuracy that the photos state for their positions, which are exact."""

OFF_MAP = "queries/off_map.jpg"
"""A photo from elsewhere. It has no position on the map, so it is not in `queries.csv`."""

_CENTRE = LatLon(50.2104, 15.8252)
_FIRST = datetime(2024, 5, 18, 15, 2, 10)
_DAYS: tuple[tuple[str, datetime, Light], ...] = (
    ("afternoon", datetime(2024, 6, 9, 15, 11, 0), AFTERNOON),
    ("evening", datetime(2024, 6, 21, 20, 14, 0), EVENING),
    ("autumn", datetime(2024, 10, 12, 13, 5, 0), AUTUMN),
    ("overcast", datetime(2024, 7, 2, 11, 40, 0), OVERCAST),
)
"""Conditions of the queries, which are assigned to them cyclically."""


@dataclass(frozen=True, slots=True)
class SampleSize:
    photos: int = 60  # Number of photos of the map
    queries: int = 11  # Number of queries on the map; one more is from elsewhere
    width: int = 640  # Of a photo, pixels, a multiple of 4; the height is three quarters of it
    metres_per_pixel: float = 0.12  # Of the satellite image


FULL_SIZE = SampleSize()


@dataclass(frozen=True, slots=True)
class SampleReport:
    cfg_path: Path  # The map
    made: bool  # False if it existed already


def make_sample(
    folder: Path | None,
    *,
    settings: Settings,
    progress: Progress,
    seed: int = 7,
    force: bool = False,
    size: SampleSize = FULL_SIZE,
) -> SampleReport:
    """Make the sample, unless it exists already.

    The same seed and size give the same files, byte by byte. The folder is written all or nothing.

    Args:
        folder: None: `sample` in the library.
        seed: Random seed of the synthetic park; 0 or more.
        force: Make it again, also replacing a different sample.

    Raises:
        UsageError: The folder holds something else, or a different or damaged sample and `force` is not
            given.
        Cancelled: Nothing was changed.
    """
    folder = settings.library / "sample" if folder is None else folder
    recipe = {"seed": seed, "photos": size.photos, "queries": size.queries, "width": size.width}
    if _is_made(folder, recipe, force=force):
        return SampleReport(folder / "map.cfg", made=False)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".tmp", dir=folder.parent))
        try:
            truth = write_sample(fresh / "new", seed=seed, size=size, progress=progress)
            record = {"note": "a synthetic park, made by a program", "recipe": recipe, **truth}
            write_text(fresh / "new" / RECORD, json.dumps(record, indent=1) + "\n")
            if folder.exists():
                folder.rename(fresh / "old")
            (fresh / "new").rename(folder)
        finally:
            shutil.rmtree(fresh)
    except OSError as error:
        reason = error.strerror or str(error)
        hint = "choose a folder that you may write to, on a disk with 20 MB free"
        raise StorageError(f"the sample cannot be written: {reason}", where=str(folder), hint=hint) from error
    return SampleReport(folder / "map.cfg", made=True)


def _is_made(folder: Path, recipe: dict[str, int], *, force: bool) -> bool:
    """Return whether the folder holds the complete sample; refuse one that must not be overwritten."""
    if not folder.exists():
        return False
    if not folder.is_dir() or (any(folder.iterdir()) and not (folder / RECORD).is_file()):
        hint = "choose a new or empty folder"
        raise UsageError("this is not a sample, so it is not overwritten", where=str(folder), hint=hint)
    if force or not (folder / RECORD).is_file():
        return False
    try:
        record = json.loads((folder / RECORD).read_text("utf-8"))
        same = record["recipe"] == recipe
        whole = all((folder / name).is_file() for name in record["files"])
    except (ValueError, TypeError, KeyError, OSError) as error:
        raise UsageError(
            f"{RECORD} is damaged", where=str(folder), hint="--force makes the sample again"
        ) from error
    if not same:
        raise UsageError(
            "the folder has a different sample",
            where=str(folder),
            hint="--force replaces it, or choose another folder",
        )
    return whole


@dataclass(frozen=True, slots=True)
class _Studio:
    """Common data of all pictures of a sample."""

    folder: Path
    size: SampleSize
    progress: Progress

    def shoot(
        self, name: str, stage: Stage, *, view: CameraView, rng: np.random.Generator, tags: CameraTags
    ) -> None:
        """Take a photo and store it."""
        self.progress.check()
        camera = view.camera(fov_deg=FOV_DEG, width=self.size.width, height=self.size.width * 3 // 4)
        photo = Image.fromarray(render(stage, camera, rng=rng))
        photo.save(self.folder / name, quality=90, exif=exif_bytes(tags))
        self.progress.advance()

    def pixel(self, view: CameraView) -> MapPixel:
        """Return the position of a view on the satellite image."""
        step = self.size.metres_per_pixel
        return MapPixel(view.east / step, (DEPTH_M - view.north) / step)


def write_sample(folder: Path, *, seed: int, size: SampleSize, progress: Progress) -> dict[str, object]:
    """Write all files of the sample except its record.

    Returns:
        For the record: the `files`, relative to the folder, and the ground truth of the `queries`.
    """
    for name in ("photos", "queries"):
        (folder / name).mkdir(parents=True)
    progress.size(size.photos + size.queries + 2)
    studio = _Studio(folder, size, progress)
    for_world, for_map, for_queries, for_elsewhere = np.random.default_rng(seed).spawn(4)
    progress.note("making a synthetic park")
    world = build_world(for_world)
    progress.note("taking photos")
    _make_map(studio, world, rng=for_map)
    queries = _make_queries(studio, world, rng=for_queries)
    _shoot_elsewhere(studio, rng=for_elsewhere)
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.*"))
    return {"files": files, "queries": queries, "off_map": OFF_MAP}


def _make_map(studio: _Studio, world: World, *, rng: np.random.Generator) -> None:
    stage = set_stage(rng, world, light=AFTERNOON)
    picture = Image.fromarray(overhead(stage, studio.size.metres_per_pixel, rng=rng))
    picture.save(studio.folder / "satellite.png")
    studio.progress.advance()
    corners = _corners()
    described = {name: getattr(corners, name)._asdict() for name in ("top_left", "bottom_right")}
    write_text(studio.folder / "corners.json", json.dumps(described, indent=1) + "\n")
    georeference = from_corners(corners, width=picture.width, height=picture.height).georeference
    experiences = []
    for number, view in enumerate(map_views(rng, world.plan, count=studio.size.photos)):
        name, position = f"photos/photo_{number:02d}.jpg", studio.pixel(view)
        taken_at = _FIRST + number * timedelta(seconds=25)
        tags = CameraTags(
            taken_at, FOCAL_35MM, georeference.latlon_of(position), view.heading_deg, accuracy_m=ACCURACY_M
        )
        studio.shoot(name, stage, view=view, rng=rng, tags=tags)
        experiences.append(
            Experience(
                number,
                name,
                position,
                heading_deg=view.heading_deg,
                fov_deg=FOV_DEG,
                gps_accuracy_m=ACCURACY_M,
                taken_at=taken_at.isoformat(),
            )
        )
    satellite = SatelliteImage("satellite.png", picture.width, picture.height)
    map_ = Map(satellite, tuple(experiences), georeference, next_id=len(experiences))
    write_map(studio.folder / "map.cfg", map_)


def _make_queries(studio: _Studio, world: World, *, rng: np.random.Generator) -> list[dict[str, object]]:
    """Photograph the park on other days; return the ground truth of each query."""
    views = query_views(rng, world.plan, count=studio.size.queries, stops=studio.size.photos)
    described: list[dict[str, object]] = []
    for day, (light, date, conditions) in enumerate(_DAYS):
        stage = set_stage(rng, world, light=conditions)
        for number in range(day, len(views), len(_DAYS)):
            name, view = f"queries/query_{number:02d}.jpg", views[number]
            studio.shoot(name, stage, view=view, rng=rng, tags=CameraTags(date, FOCAL_35MM))
            x, y = (round(side, 2) for side in studio.pixel(view))
            heading = round(view.heading_deg, 2)
            described.append({"path": name, "x": x, "y": y, "heading_deg": heading, "light": light})
    described.sort(key=lambda query: str(query["path"]))
    lines = [HEADER, *(f"{query['path']};{query['x']};{query['y']}" for query in described)]
    write_text(studio.folder / "queries.csv", "\n".join(lines) + "\n")
    return described


def _shoot_elsewhere(studio: _Studio, *, rng: np.random.Generator) -> None:
    """Photograph another park, in the same light."""
    world = build_world(rng)
    view = map_views(rng, world.plan, count=5)[2]
    tags = CameraTags(_DAYS[0][1] + timedelta(days=1), FOCAL_35MM)
    studio.shoot(OFF_MAP, set_stage(rng, world, light=AFTERNOON), view=view, rng=rng, tags=tags)


def _corners() -> Corners:
    """Return the corners of the park; degrees are rounded to 0.1 mm, and the rounded ones are the truth."""
    frame = LocalFrame(_CENTRE)
    north_west = frame.latlon_of(EnuMetres(-WIDTH_M / 2, DEPTH_M / 2))
    south_east = frame.latlon_of(EnuMetres(WIDTH_M / 2, -DEPTH_M / 2))
    return Corners(*(LatLon(round(lat, 9), round(lon, 9)) for lat, lon in (north_west, south_east)))
