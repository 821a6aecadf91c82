"""How photos and plans are understood: what is read from their files and from those beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.errors import GeoreferenceError, MissingPart, PhotoError
from webapp.files.decode import check_decodes, contrast_note
from webapp.files.photos.exif import Gps
from webapp.files.photos.panorama import find_panorama
from webapp.files.photos.photo import PhotoFacts, read_facts
from webapp.files.photos.sidecars import choose, is_sidecar, read_sidecars, with_sidecars
from webapp.files.satellite.georeference_files import find_worldfile, read_geotiff
from webapp.files.satellite.raster import image_kind, opened_raster
from webapp.settings import Settings


@dataclass(frozen=True, slots=True)
class PlanFacts:
    # `width`, `height`: As it is shown, pixels.
    width: int
    height: int
    georeference: Georeference | None = None  # Of a GeoTIFF
    problem: str | None = None  # Why there is no georeference, or it cannot be read
    worldfile: str | None = None  # Name of its world file

    @property
    def metres_per_pixel(self) -> float | None:
        """The scale in its middle."""
        if self.georeference is None:
            return None
        return self.georeference.metres_per_pixel(MapPixel(self.width / 2, self.height / 2))


@dataclass(frozen=True, slots=True)
class ImageReport:
    """What was understood of a file; without photo and plan it is not an image that can be read."""

    name: str
    photo: PhotoFacts | None
    is_panorama: bool = False
    plan: PlanFacts | None = None
    problem: str | None = None  # Why it cannot be used as a photo
    hint: str | None = None

    @property
    def is_read(self) -> bool:
        """Whether it can be used as a photo or as a plan."""
        return self.photo is not None or self.plan is not None


def inspect_image(path: Path, *, settings: Settings) -> ImageReport:
    """Read a photo or a plan; a bad file is a result, not an exception."""
    plan = _plan(path, settings)
    limits = settings.photo
    try:
        facts = read_facts(path, limits=limits)
        check_decodes(path, limits=limits)
        contrast = contrast_note(path, limits=limits)
        around = find_panorama(path, facts, limits=limits)
    except PhotoError as error:
        return ImageReport(path.name, None, plan=plan, problem=error.message, hint=error.hint)
    if contrast is not None:
        facts = replace(facts, notes=(*facts.notes, contrast))
    facts = with_sidecars(facts, read_sidecars(_beside(path)))
    return ImageReport(path.name, facts, around is not None, plan)


def _beside(path: Path) -> Sequence[Path]:
    there = sorted(other for other in path.parent.iterdir() if is_sidecar(other.name))
    return [path.with_name(name) for name in choose(path.name, [other.name for other in there])]


def _plan(path: Path, settings: Settings) -> PlanFacts | None:
    """Read an image as a plan; None unless its format is one of those that are shown."""
    try:
        if not path.is_file() or image_kind(path) is None:
            return None
        with opened_raster(path, limits=settings.satellite) as raster:
            width, height, placed = raster.width, raster.height, raster.georeferenced
    except (PhotoError, MissingPart):
        return None  # it is reported as a photo
    if not placed:
        width, height = _upright_size(path, settings, stored=(width, height))
    georeference, problem = None, None
    if image_kind(path) == "GTiff":
        try:
            georeference = read_geotiff(path).georeference
        except GeoreferenceError as error:
            problem = error.message
    return PlanFacts(width, height, georeference, problem, _worldfile(path))


def _upright_size(path: Path, settings: Settings, *, stored: tuple[int, int]) -> tuple[int, int]:
    try:
        facts = read_facts(path, limits=replace(settings.photo, max_mb=settings.satellite.max_mb))
    except PhotoError:
        return stored
    return facts.width, facts.height


def _worldfile(path: Path) -> str | None:
    try:
        return find_worldfile(path).name
    except GeoreferenceError:
        return None


def as_json(report: ImageReport) -> dict[str, object]:
    facts, plan = report.photo, report.plan
    return {
        "file": report.name,
        "problem": report.problem,
        "photo": None if facts is None else _photo_json(facts, is_panorama=report.is_panorama),
        "plan": plan
        and {
            "width": plan.width,
            "height": plan.height,
            "georeference": plan.georeference and plan.georeference.plane,
            "metres_per_pixel": plan.metres_per_pixel,
            "problem": plan.problem,
            "worldfile": plan.worldfile,
        },
    }


def _photo_json(facts: PhotoFacts, *, is_panorama: bool) -> dict[str, object]:
    gps = facts.gps if isinstance(facts.gps, Gps) else None
    return {
        "format": facts.format,
        "width": facts.width,
        "height": facts.height,
        "orientation": facts.orientation,
        "lat": gps and gps.lat,
        "lon": gps and gps.lon,
        "position_from": gps and gps.source,
        "no_position": None if isinstance(facts.gps, Gps) else facts.gps.reason,
        "accuracy_m": gps and gps.accuracy_m,
        "altitude_m": gps and gps.altitude_m,
        "relative_altitude_m": gps and gps.relative_altitude_m,
        "heading_deg": facts.heading_deg,
        "heading_reference": facts.heading and facts.heading.reference,
        "pitch_deg": facts.pitch_deg,
        "fov_deg": 360.0 if is_panorama else facts.fov_deg,
        "fov_from": facts.fov and facts.fov.source,
        "taken_at": facts.taken_at,
        "camera": facts.camera,
        "panorama": is_panorama,
        "notes": list(facts.notes),
    }
