"""Makes a map from a folder of photos, placed on a satellite image or on a blank plan."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from webapp.core.boxes import BlurBox
from webapp.core.geo.blank import BlankPlan, draw, plan_around
from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.model import Map, SatelliteImage
from webapp.core.mapmodel.panorama import band
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import StorageError, UsageError
from webapp.files.atomic import write_bytes
from webapp.files.decode import image_size
from webapp.files.listing import DERIVED, list_files
from webapp.files.maps.folder import read_map, write_map
from webapp.files.maps.positions import Positions, read_positions
from webapp.files.photos.panorama import read_mask
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.maps.place_photos import (
    FileResult,
    FileState,
    MapImage,
    SurveyedFile,
    place,
    survey,
    unplaced,
    with_ids,
)
from webapp.tasks.satellite import georeference
from webapp.tasks.satellite.georeference import GeoSource
from webapp.tasks.satellite.upright import upright_copy, upright_name

_FAR_M = 50_000.0

_PHOTOS = "photos"


@dataclass(frozen=True, slots=True)
class PanoramaOptions:
    """How panoramas are recognised and masked."""

    # Treat all photos twice as wide as high as panoramas, even without panorama metadata.
    assume: bool = False
    mask: Path | None = None  # Image that is black where features are ignored in all panoramas
    # `lowest_deg`, `highest_deg`: Limits below and above the horizon, beyond which panoramas are masked.
    lowest_deg: float = 90.0
    highest_deg: float = 90.0


@dataclass(frozen=True, slots=True)
class PlaceOptions:
    cfg: Path  # The map to write
    satellite: Path | None = None  # The image; None makes a blank plan
    source: GeoSource | None = None  # Source of the image's georeference; not needed for positions in pixels
    positions: Path | None = None  # Positions by file name, instead of those in and beside the photos
    columns: str | None = None  # Meaning of the columns of a table of positions; None to guess it
    copy: bool = False  # Copy files from outside the map's folder into it
    force: bool = False  # Replace an existing map; its photos keep their ids
    panoramas: PanoramaOptions = PanoramaOptions()


@dataclass(frozen=True, slots=True)
class PlaceReport:
    """The result for each file of the folder, and for the georeference of the image."""

    cfg: Path
    written: bool  # False if no photo could be placed: no map is written
    satellite: SatelliteImage | None
    files: tuple[FileResult, ...]
    residuals_m: tuple[float, ...] = ()  # Residuals of the control points, metres
    warnings: tuple[str, ...] = ()

    def count(self, state: FileState) -> int:
        return sum(file.state is state for file in self.files)


def map_from_photos(
    folder: Path, *, options: PlaceOptions, settings: Settings, progress: Progress
) -> PlaceReport:
    """Make a map from the photos of a folder.

    Args:
        folder: Searched recursively.

    Returns:
        Lists every file, placed or not.

    Raises:
        UsageError: Invalid options: the map exists, photos or image lie outside its folder, there is no
            georeference, the positions are too far apart for a blank plan ...
        GeoreferenceError, TableError: The georeference or the positions cannot be read.
        MapError: The map to replace, or a `.cfg` with the positions, cannot be read.
        PhotoError: The satellite image cannot be read.
        StorageError: A file cannot be written.
    """
    with TemporaryDirectory() as scratch:
        return _make_map(folder, options=options, settings=settings, progress=progress, scratch=Path(scratch))


def _make_map(
    folder: Path, *, options: PlaceOptions, settings: Settings, progress: Progress, scratch: Path
) -> PlaceReport:
    target = NewMapFolder(options.cfg, folder, copy=options.copy)
    target.check(force=options.force, satellite=options.satellite)
    before = read_map(options.cfg) if options.cfg.exists() else None
    positions = read_positions(options.positions, columns=options.columns) if options.positions else None
    _check_sources(options, positions)
    # fail early: read the image before the many photos
    shown = _upright(options, positions, scratch=scratch, settings=settings)
    image = _georeferenced(options, shown) if shown else None
    _check_same_image(positions, image)
    names = list_files(folder, leave_out=[options.cfg.parent / DERIVED])
    around = options.panoramas
    image_path = target.path_of(options.satellite, shown) if shown else target.plan_path
    own = [path for path in (image_path, options.satellite, around.mask) if path is not None]
    masked = band(lowest_deg=around.lowest_deg, highest_deg=around.highest_deg)
    masked += () if around.mask is None else read_mask(around.mask, limits=settings.photo)
    seen = survey(
        folder,
        names,
        positions=positions,
        limits=settings.photo,
        progress=progress,
        assume_panoramas=around.assume,
    )
    seen = [_own_file(s) if target.same(folder / s.name, own) else s for s in seen]
    plan = None
    if image is None:
        latlon = {s.name: s.position for s in seen if isinstance(s.position, LatLon)}
        if not latlon:
            return PlaceReport(options.cfg, False, None, tuple(unplaced(s) for s in seen))
        plan = plan_around(list(latlon.values()))
        _refuse_far_apart(plan, latlon)
        image = MapImage(plan.width, plan.height, plan.georeference)
    placed = [_masked(place(s, image, photo=target.photo_name(s.name)), masked) for s in seen]
    files, next_id = with_ids(placed, before)
    experiences = tuple(f.experience for f in files if f.experience is not None)
    satellite = SatelliteImage(target.image_name(options.satellite, shown), image.width, image.height)
    if experiences:
        revision = before.revision + 1 if before else 0
        map_ = Map(satellite, experiences, image.georeference, next_id=next_id, revision=revision)
        originals = {f.experience.photo: f.name for f in files if f.experience is not None}
        target.write(map_, originals=originals, satellite=shown, plan=plan)
    written = bool(experiences)
    return PlaceReport(options.cfg, written, satellite, tuple(files), image.residuals_m, image.warnings)


def _masked(file: FileResult, masked: tuple[BlurBox, ...]) -> FileResult:
    if file.experience is None or file.experience.panorama is None:
        return file
    return replace(
        file, experience=replace(file.experience, panorama=replace(file.experience.panorama, masked=masked))
    )


def _check_sources(options: PlaceOptions, positions: Positions | None) -> None:
    pixels = positions is not None and positions.in_pixels
    if options.satellite is None and pixels:
        hint = "give the image with --satellite, or positions as name;lat;lon"
        raise UsageError(
            "positions in pixels need the image that they are on", where="--positions", hint=hint
        )
    if options.satellite is None and options.source is not None:
        raise UsageError(
            "a blank plan has its own georeference", where="--blank", hint="leave one of them out"
        )
    if options.satellite is not None and options.source is None and not pixels:
        hint = "give --corners, --geotiff, --worldfile or --control-points; or --blank instead of an image"
        raise UsageError("the satellite image has no georeference", hint=hint)


_OF_STORED_PIXELS = frozenset({"geotiff", "worldfile"})
"""Kinds of georeferences that other programs write for the pixels as stored."""


def _upright(
    options: PlaceOptions, positions: Positions | None, *, scratch: Path, settings: Settings
) -> Path | None:
    """Return the image as it is used in the map: upright, as viewers show it."""
    path = options.satellite
    if path is None or (options.source is not None and options.source.kind in _OF_STORED_PIXELS):
        return path
    described = positions.image_size if positions else None
    return upright_copy(path, scratch=scratch, settings=settings, described=described) or path


def _georeferenced(options: PlaceOptions, shown: Path) -> MapImage:
    width, height = image_size(shown)
    if options.source is None or options.satellite is None:
        return MapImage(width, height, None)
    fit = georeference.georeference_image(options.satellite, options.source, width=width, height=height)
    return MapImage(width, height, fit.georeference, fit.residuals_m, fit.warnings)


def _check_same_image(positions: Positions | None, image: MapImage | None) -> None:
    if positions is None or positions.image_size is None or image is None:
        return
    if positions.image_size != (image.width, image.height):
        stated = "{} x {}".format(*positions.image_size)
        raise UsageError(
            f"the positions are on an image of {stated} pixels, the satellite image has "
            f"{image.width} x {image.height}",
            where="--positions",
            hint="give the image that they were made on",
        )


def _own_file(surveyed: SurveyedFile) -> SurveyedFile:
    return SurveyedFile(surveyed.name, state=FileState.NOT_A_PHOTO, reason="it is the map's own image")


def _refuse_far_apart(plan: BlankPlan, latlon: Mapping[str, LatLon]) -> None:
    """Refuse a plan that spans a huge area, because of two separate places or a wrong position."""
    if max(plan.width, plan.height) * plan.metres_per_pixel < _FAR_M:
        return
    pixels = plan.georeference.pixel_from_latlon(list(latlon.values()))
    along = pixels[:, int(plan.height > plan.width)]
    first, last = (list(latlon)[int(end)] for end in (along.argmin(), along.argmax()))
    extent_km = float(np.ptp(along)) * plan.metres_per_pixel / 1000.0
    raise UsageError(
        f"the photos are spread over {extent_km:.0f} km, from {first} to {last}",
        where="--blank",
        hint="make a map of each place, leave out wrong positions, or give an image with --satellite",
    )


class NewMapFolder:
    """The folder into which a map is written.

    Args:
        copy: Whether to copy photos and image from outside the map's folder into it.
    """

    def __init__(self, cfg: Path, photos: Path, *, copy: bool) -> None:
        self._cfg = cfg
        self._base = cfg.parent.resolve()
        self._photos = photos
        self._copy = copy

    @property
    def plan_path(self) -> Path:
        """Path of the blank plan: `plan.png` for `map.cfg`, `NAME.plan.png` for any other `NAME.cfg`."""
        return self._cfg.with_name("plan.png" if self._cfg.stem == "map" else f"{self._cfg.stem}.plan.png")

    def check(self, *, force: bool, satellite: Path | None) -> None:
        """Refuse options that would overwrite files, or that a map cannot represent. Raises UsageError."""
        if self._cfg.suffix.lower() != ".cfg":
            raise UsageError("a map's name ends in .cfg", where=str(self._cfg), hint="write -o MAP.cfg")
        if not self._photos.is_dir():
            raise UsageError("folder not found", where=str(self._photos), hint="check its path")
        for path in (self._cfg, self.plan_path) if satellite is None else (self._cfg,):
            if path.exists() and not force:
                raise UsageError("it already exists", where=str(path), hint="--force replaces it")
        if not self._copy and not self._photos.resolve().is_relative_to(self._base):
            hint = "write the map into the photos' folder or one above it, or add --copy to copy the photos"
            raise UsageError("the photos lie outside the map's folder", where=str(self._photos), hint=hint)
        self.image_name(satellite)

    def same(self, path: Path, others: Iterable[Path]) -> bool:
        # unlike Path.resolve, os.path.realpath does not fail on circular links
        return any(os.path.realpath(path) == os.path.realpath(other) for other in others)

    def photo_name(self, name: str) -> str:
        """Return the name of a photo in the map, relative to the map's folder."""
        folder = self._photos.resolve()
        if folder.is_relative_to(self._base):
            return (folder / name).relative_to(self._base).as_posix()
        return f"{_PHOTOS}/{name}"

    def path_of(self, satellite: Path | None, shown: Path | None) -> Path:
        """Return the path of the satellite image in the map; see `image_name`."""
        return self._base / self.image_name(satellite, shown)

    def image_name(self, satellite: Path | None, shown: Path | None = None) -> str:
        """Return the name of the satellite image or blank plan in the map.

        Args:
            satellite: The file that was given.
            shown: The same, or an upright copy.

        Raises:
            UsageError: The image lies outside the map's folder without the option `copy`, or has an
                unsuitable name.
        """
        if satellite is None:
            return self.plan_path.name
        parent = satellite.parent.resolve()
        if parent.is_relative_to(self._base):
            name = (parent / satellite.name).relative_to(self._base).as_posix()
        elif self._copy:
            name = satellite.name
        else:
            hint = "move it into the map's folder, or add --copy to copy it"
            raise UsageError(
                "the satellite image lies outside the map's folder", where=str(satellite), hint=hint
            )
        if shown is not None and shown != satellite:
            name = upright_name(name, shown)
        problem = name_problem(name)
        if problem:
            raise UsageError(problem.message, where=str(satellite), hint="rename the file")
        return name

    def write(
        self, map_: Map, *, originals: Mapping[str, str], satellite: Path | None, plan: BlankPlan | None
    ) -> None:
        """Copy files into the map's folder as needed, then write the map, its `.cfg` last.

        Args:
            originals: Name in the map -> name in the photos' folder, for each photo.
            plan: The blank plan to draw.

        Raises:
            StorageError, UsageError: A file cannot be written, or a copy would replace another file.
        """
        try:
            self._base.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            message = f"the folder cannot be created: {error.strerror}"
            raise StorageError(message, where=str(self._base), hint="choose another folder") from error
        for name, original in originals.items():
            self._bring(self._photos / original, name)
        if satellite is not None:
            self._bring(satellite, map_.satellite.path)
        if plan is not None:
            write_bytes(self.plan_path, cv2.imencode(".png", draw(plan))[1].tobytes())
        write_map(self._cfg, map_)

    def _bring(self, source: Path, name: str) -> None:
        target = self._base / name
        if self.same(source, [target]):
            return
        try:
            data = source.read_bytes()
            if target.exists() and target.read_bytes() != data:
                raise UsageError("another file has this name", where=str(target), hint="remove or rename it")
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            message = f"it cannot be copied: {error.strerror}"
            raise StorageError(message, where=str(source), hint="check its permissions") from error
        write_bytes(target, data)
