"""Says where a photo was taken."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from webapp.core.features.extract import extract
from webapp.core.hypotheses.calibration import DEFAULT
from webapp.core.hypotheses.model import Answer, FieldOfView
from webapp.core.hypotheses.path_prior import apply_path_prior_to_answer
from webapp.core.localize import vote
from webapp.core.localize.verified import find_places, with_probabilities
from webapp.core.mapmodel.model import Map
from webapp.core.reconstruction.depths import DepthObservations, DepthsExcluding
from webapp.files.localize.calibration import StoredCalibration
from webapp.files.localize.models import network
from webapp.files.photos.photo import read_facts, read_gray
from webapp.settings import Settings
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.open_map import OpenMap, guessed_fov_deg


@dataclass(frozen=True, slots=True, eq=False)
class PhotoLocalizer:
    """A method on an open map.

    Attributes
    ----------
    opened : OpenMap
    settings : Settings
    calibration : StoredCalibration or None
        None for a method that has none.
    fov_deg : float or None
        Horizontal field of view of the queries, instead of what their EXIF says.
    sightings : Sightings or None
        Of the map's keypoints, where photos are to be hidden: for depths that do not rest on them. Where
        this is None, no depths are used then.
    """

    opened: OpenMap
    settings: Settings
    calibration: StoredCalibration | None = None
    fov_deg: float | None = None
    sightings: DepthObservations | None = None

    def localize(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        """Localize one photo.

        Parameters
        ----------
        photo_path : Path
        top : int
            At most so many hypotheses.
        hide : frozenset of int
            Experience ids to leave out.

        Raises
        ------
        PhotoError
            The photo cannot be used.
        """
        return apply_path_prior_to_answer(
            self.look(photo_path, top=top, hide=hide), self.opened.indexed.paths
        )

    def look(
        self,
        photo_path: Path,
        *,
        top: int,
        hide: frozenset[int] = frozenset(),
        closer: frozenset[int] = frozenset(),
    ) -> Answer:
        """Tell what one photo says by itself, before anything that is known of where photos are taken.

        Parameters
        ----------
        photo_path : Path
        top : int
        hide : frozenset of int
        closer : frozenset of int
            Experience ids that are looked at in any case; `vote` looks at all.

        Raises
        ------
        PhotoError
        """
        clock = [time.perf_counter()]
        limits, options = self.settings.photo, self.settings.extract
        gray = read_gray(photo_path, limits=limits, max_side=options.max_side_px)
        fov = self._fov(photo_path, gray.full_size) if self.method != "vote" else None
        clock.append(time.perf_counter())
        choice = self.opened.choice
        features = extract(
            gray.pixels,
            choice,
            keypoints=options.keypoints,
            scale=gray.scale,
            photo_size=gray.full_size,
            network=network(choice.model, self.settings.models, weights=choice.weights),
        )
        clock.append(time.perf_counter())
        if fov is None:
            answer = vote.localize(self.opened.indexed, features, top=top, hide=hide)
        else:
            indexed = self.opened.indexed
            found = find_places(
                indexed,
                features,
                fov_deg=fov.degrees,
                hide=hide,
                closer=closer,
                depths=self._depths_without(hide) if hide else None,
            )
            calibration = self.calibration.calibration if self.calibration else DEFAULT
            answer = with_probabilities(indexed, found, calibration=calibration, top=top)
        clock.append(time.perf_counter())
        times = {"read": clock[1] - clock[0], "extract": clock[2] - clock[1], "total": clock[3] - clock[0]}
        if not answer.seconds:
            times["retrieve"] = clock[3] - clock[2]
        return replace(answer, seconds={**answer.seconds, **times}, fov=fov)

    def _depths_without(self, hide: frozenset[int]) -> DepthsExcluding | None:
        if self.sightings is None:
            return None
        return DepthsExcluding(self.sightings, np.isin(self.opened.indexed.ids, [*hide]))

    def _fov(self, photo_path: Path, size: tuple[int, int]) -> FieldOfView:
        if self.fov_deg is not None:
            return FieldOfView(self.fov_deg, "option")
        exif = read_facts(photo_path, limits=self.settings.photo).fov_deg
        if exif is not None:
            return FieldOfView(exif, "exif")
        return FieldOfView(guessed_fov_deg(*size), "guess")

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.opened.method

    @property
    def features(self) -> str:
        """Name of the features, `auto` resolved."""
        return self.opened.choice.name

    @property
    def map(self) -> Map:
        """Where it looks."""
        return self.opened.map

    @property
    def map_hash(self) -> str:
        """Stands for the map's photos and positions."""
        return self.opened.map_hash

    @property
    def place_radius_px(self) -> float:
        """How far off a right hypothesis may be, map pixels."""
        return self.opened.indexed.place_radius_px

    @property
    def build_seconds(self) -> float | None:
        """Time the index took."""
        return self.opened.manifest.build_seconds

    @property
    def calibration_seconds(self) -> float | None:
        """Time the calibration took; None for a method that has none."""
        return self.calibration.seconds if self.calibration else None

    @property
    def index_bytes(self) -> int:
        """Size of the index on disk."""
        return self.opened.folder.bytes_on_disk()


def parts(localizer: PhotoLocalizer) -> dict[str, Any]:
    """Take a localizer apart, for one of another kind to be made of it."""
    return {f.name: getattr(localizer, f.name) for f in fields(PhotoLocalizer)}


def for_own_photos(localizer: PhotoLocalizer) -> PhotoLocalizer:
    """Prepare a localizer for the photos of its own map, which are hidden in turn.

    Raises
    ------
    StorageError
    """
    known, opened = localizer.calibration, localizer.opened
    if known is None:
        return localizer
    return replace(localizer, sightings=orient_map.sightings(opened, map_fov_deg=known.map_fov_deg))
