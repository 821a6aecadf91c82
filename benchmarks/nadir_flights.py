"""Measures focal length and positions of simulated flights straight down over flat ground, with known truth.

    python -m benchmarks.nadir_flights

Such photos hardly say how large the focal length is: with one that is too large, all cameras are too high
over the same ground. Each flight is joined from its matches, and adjusted to a few clicks: without altitudes
and the prior of the focal length, with either, and with both. Altitudes scatter by 0.2 m and drift by 1.5 m
over the flight, clicks scatter by 0.2 m along each axis, keypoints by half a pixel; a rolling shutter and a
distortion are not in the model of the camera. `focal` is a share of the true focal length, by run, and
`height_m` that of the cameras above the ground. Prints one JSON object per line.
"""

from __future__ import annotations

import json
import math
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.geometry import so3
from webapp.core.landmarks.georegister import georegister
from webapp.core.landmarks.heights import Altitude, Altitudes
from webapp.core.landmarks.placing import AlignedSubmodel, KnownPositions
from webapp.core.landmarks.submodels import Submodel
from webapp.files.landmarks import position_priors
from webapp.files.landmarks.adjust import adjust
from webapp.files.landmarks.colmap import Model, StoredSubmodels, pycolmap
from webapp.files.landmarks.match_database import MatchDatabase, two_view_geometry
from webapp.tasks.landmarks.adjust import Facts, adjust_job, positions_of
from webapp.tasks.landmarks.mapping import MATCHES_FILE, MappingJob, map_photos, model_folders

Array = NDArray[np.float64]

RUNS = 2
PX_PER_M = 10.0
CLICK_M = 0.2
SIZE, FOCAL, DISTORTION = (1000, 750), 700.0, (-0.01, 0.004)
"""Of the photos, pixels; the true focal length; coefficients of the second and fourth power of the radius."""

_STEP_M, _ROW_M = 12.0, 16.0
_SHUTTER_M = 0.1
"""How far the camera moves while the rows of a photo are read out: 3 m/s for 1/30 s."""


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """n photos in rows, and what they show: x to the right and y down the map, z into the ground, metres."""

    centre: Array  # (n, 3) float64
    rotation: Array  # (n, 3, 3) float64. Camera from world.
    seen: list[NDArray[np.int64]]  # Numbers of the points that each photo shows
    xy: list[Array]  # Where it shows them, pixels
    exif_focal: float  # Focal length that EXIF states, pixels


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one flight."""

    focal: float  # As a share of the true one
    height_m: float  # Median height of the cameras above the median point
    error_m: Array  # (p,) float64. Of the photos that were not clicked.
    radius_m: Array  # (p,) float64


def fly(
    rng: np.random.Generator, *, rows: int, columns: int, heights_m: tuple[float, ...], exif_off: float
) -> Flight:
    """Fly rows to and fro at constant yaw, tilted by 0.2 degrees; rows take turns at the heights.

    Args:
        exif_off: Relative error of the focal length by EXIF.
    """
    column, row = (part.ravel() for part in np.meshgrid(np.arange(columns), np.arange(rows)))
    up = np.array(heights_m)[row % len(heights_m)] + rng.normal(0.0, 0.15, rows * columns)
    centre = np.column_stack([_STEP_M * column, _ROW_M * row, -up])
    centre[:, :2] += rng.normal(0.0, 0.5, (len(centre), 2))
    tilt: Array = rng.normal(0.0, 0.003, (len(centre), 3))
    rotation = so3.retract(np.tile(np.eye(3), (len(tilt), 1, 1)), tilt)
    low, high = centre.min(0)[:2] - 30.0, centre.max(0)[:2] + 30.0
    count = round(0.12 * float(np.prod(high - low)))
    ground = np.column_stack([rng.uniform(low, high, (count, 2)), rng.normal(0.0, 0.1, count)])
    seen, xy = [], []
    for at, turn, forth in zip(centre, rotation, row % 2 == 0, strict=True):
        away, moved = ground - at, np.array([_SHUTTER_M if forth else -_SHUTTER_M, 0.0, 0.0])
        late = _project(away @ turn.T)[:, 1:] / SIZE[1] - 0.5
        there = _project((away - late * moved) @ turn.T)
        inside = np.flatnonzero((there > 0.0).all(1) & (there < SIZE).all(1))
        seen.append(inside)
        xy.append(there[inside] + rng.normal(0.0, 0.5, (len(inside), 2)))
    return Flight(centre, rotation, seen, xy, FOCAL * (1.0 + exif_off))


def _project(points: Array) -> Array:
    flat = points[:, :2] / points[:, 2:]
    square = (flat**2).sum(1, keepdims=True)
    bent = flat * (1.0 + DISTORTION[0] * square + DISTORTION[1] * square**2)
    pixels: Array = FOCAL * bent + np.array(SIZE) / 2.0
    return pixels


def write_matches(flight: Flight, path: Path) -> tuple[str, ...]:
    """Write the matches of a flight into a database; return the names of its photos."""
    database = MatchDatabase(path)
    fov = math.degrees(2.0 * math.atan(SIZE[0] / 2.0 / flight.exif_focal))
    contents = tuple(f"{number:03}" for number in range(len(flight.xy)))
    stored = [
        database.add(content, _features(xy), fov_deg=fov, is_guessed=False)
        for content, xy in zip(contents, flight.xy, strict=True)
    ]
    for one, other in zip(*np.triu_indices(len(contents), 1), strict=True):
        _, *rows = np.intersect1d(flight.seen[one], flight.seen[other], return_indices=True)
        if len(rows[0]) < 30:
            continue
        matches = np.column_stack(rows).astype(np.uint32)
        database.keep(
            stored[one],
            stored[other],
            geometry=two_view_geometry(stored[one], stored[other], matches=matches),
        )
    database.close()
    return contents


def _features(xy: Array) -> Features:
    count = len(xy)
    return Features(
        xy=(xy - 0.5).astype(np.float32),
        size=np.ones(count, np.float32),
        angle=np.zeros(count, np.float32),
        descriptors=np.zeros((count, 128), np.uint8),
        photo_size=SIZE,
    )


def altitudes_of(flight: Flight, rng: np.random.Generator) -> Altitudes:
    """Return the heights above the start as a drone writes them; the start is 7 m below the ground."""
    count = len(flight.centre)
    above = 7.0 - flight.centre[:, 2] + rng.normal(0.0, 0.2, count) + np.linspace(0.0, 1.5, count)
    return Altitudes(tuple(Altitude(100.0 + one, one) for one in above.round(1).tolist()), PX_PER_M)


class Joined:
    """A flight joined from its matches, to be adjusted in several ways; its clicks are the same in all.

    Args:
        folder: Empty; for the matches and models.
        clicks: Number of placed photos, spread over the flight.
    """

    def __init__(self, flight: Flight, folder: Path, *, clicks: int, rng: np.random.Generator) -> None:
        self._flight, self._folder = flight, folder
        self._contents = write_matches(flight, folder / MATCHES_FILE)
        self._model = max(
            map_photos(MappingJob(folder / MATCHES_FILE, folder, self._contents)),
            key=lambda model: len(model.contents),
        )
        count = len(self._contents)
        middle = np.linspace(0, count - 1, clicks).round().astype(np.int64)
        self.clicked = np.unique(np.clip(middle + rng.integers(-1, 2, clicks), 0, count - 1))
        at = np.full(count, complex(math.nan, math.nan))
        true = flight.centre[self.clicked, :2] + rng.normal(0.0, CLICK_M, (len(self.clicked), 2))
        at[self.clicked] = PX_PER_M * (true @ np.array([1.0, 1.0j]))
        self._known = KnownPositions(at, np.full(count, PX_PER_M * CLICK_M), np.zeros(count, np.bool_))
        self._altitudes = altitudes_of(flight, rng)

    @property
    def focal_before(self) -> float:
        """The focal length of the joined model before it was adjusted, as a share of the true one."""
        return _focal(model_folders(self._folder)[0]) / FOCAL

    def adjusted(self, *, altitudes: bool, focal_prior: bool) -> Outcome | None:
        """Adjust the flight to its clicks; None if the photos contradict them."""
        rigid = _submodel(self._model)
        aligned = georegister(rigid, self._known, points=()).aligned
        assert isinstance(aligned, AlignedSubmodel), aligned
        count, out = len(self._contents), self._folder / "adjusted"
        positions = positions_of(
            self._contents,
            Facts(self._known, altitudes=self._altitudes if altitudes else None),
            photo=np.arange(count),
            turn_deg=np.zeros(count, np.int64),
        )
        job = adjust_job(
            StoredSubmodels((rigid,), self._contents, "key"),
            positions,
            aligned=[(rigid, aligned)],
            matches=self._folder / MATCHES_FILE,
            folder=self._folder,
            out=out,
        )
        with ExitStack() as stack:
            if not focal_prior:
                stack.enter_context(patch.object(position_priors, "known_focal_lengths", lambda _: {}))
            model = adjust(job)
        return None if model is None else self._outcome(model, out)

    def _outcome(self, model: Model, out: Path) -> Outcome:
        joined = _submodel(model)
        placed = georegister(joined, self._known, points=()).aligned
        assert isinstance(placed, AlignedSubmodel), placed
        rest = ~np.isin(joined.photo, self.clicked)
        truth = PX_PER_M * self._flight.centre[joined.photo, :2] @ np.array([1.0, 1.0j])
        points = pycolmap().Reconstruction(out).points3D.values()
        ground = float(np.median([point.xyz[2] for point in points]))
        return Outcome(
            _focal(out) / FOCAL,
            (ground - float(np.median(joined.centre[:, 2]))) / PX_PER_M,
            np.abs(placed.at - truth)[rest] / PX_PER_M,
            placed.radius_px[rest] / PX_PER_M,
        )


def _submodel(model: Model) -> Submodel:
    photo = np.array([int(content) for content in model.contents], np.int64)
    return Submodel(photo, model.centre, model.rotation, covariance=model.covariance)


def _focal(folder: Path) -> float:
    (camera,) = (c for c in pycolmap().Reconstruction(folder).cameras.values() if c.width == SIZE[0])
    return float(camera.params[0])


def measure(*, heights_m: tuple[float, ...], exif_off: float, clicks: int = 5) -> list[dict[str, object]]:
    """Measure flights of 24 photos in all four ways."""
    ways = [(altitudes, prior) for altitudes in (False, True) for prior in (False, True)]
    found: dict[tuple[bool, bool], list[Outcome]] = {way: [] for way in ways}
    before = []
    for run in range(RUNS):
        rng = np.random.default_rng([52, run])
        flight = fly(rng, rows=4, columns=6, heights_m=heights_m, exif_off=exif_off)
        with tempfile.TemporaryDirectory() as folder:
            joined = Joined(flight, Path(folder), clicks=clicks, rng=rng)
            before.append(joined.focal_before)
            for altitudes, prior in ways:
                outcome = joined.adjusted(altitudes=altitudes, focal_prior=prior)
                if outcome is not None:
                    found[altitudes, prior].append(outcome)
    true = {"heights_m": heights_m, "exif_focal_off": exif_off, "focal_joined": _rounded(before)}
    return [
        {**true, "altitudes": way[0], "focal_prior": way[1], **_figures(some)} for way, some in found.items()
    ]


def _figures(outcomes: list[Outcome]) -> dict[str, object]:
    if not outcomes:
        return {"adjusted": 0}
    error, radius = (
        np.concatenate([getattr(one, name) for one in outcomes]) for name in ("error_m", "radius_m")
    )
    return {
        "adjusted": len(outcomes),
        "focal": _rounded([one.focal for one in outcomes]),
        "height_m": _rounded([one.height_m for one in outcomes]),
        "median_m": round(float(np.median(error)), 3),
        "largest_m": round(float(error.max()), 3),
        "within_radius": round(float(np.mean(error <= radius)), 2),
        "median_radius_m": round(float(np.median(radius)), 3),
    }


def _rounded(values: list[float]) -> list[float]:
    return [round(value, 3) for value in values]


def main() -> None:
    """Run as a command."""
    for heights_m in ((40.0,), (40.0, 55.0)):
        for exif_off in (0.02, -0.09):
            for line in measure(heights_m=heights_m, exif_off=exif_off):
                print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
