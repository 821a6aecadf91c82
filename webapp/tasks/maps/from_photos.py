"""A map from a folder of photos: their positions become pixels of a satellite image, or of a blank plan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from webapp.core.geo.blank import BlankPlan, plan_around
from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.model import Map, SatelliteImage
from webapp.errors import UsageError
from webapp.files.listing import DERIVED, list_files
from webapp.files.maps.folder import read_map
from webapp.files.maps.positions import Positions, read_positions
from webapp.files.satellite.image_probe import image_size
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.maps.new_folder import NewMapFolder
from webapp.tasks.maps.place_photos import FileResult, MapImage, place, unplaced, with_ids
from webapp.tasks.maps.survey_photos import FileState, Surveyed, survey
from webapp.tasks.satellite import georeference_image
from webapp.tasks.satellite.georeference_image import GeoSource

_FAR_M = 50_000.0


@dataclass(frozen=True, slots=True)
class PlaceOptions:
    """What the user asks for.

    Attributes
    ----------
    cfg : Path
        The map to write.
    satellite : Path or None
        The image; None makes a blank plan.
    source : GeoSource or None
        Where the image's georeference comes from; not needed with positions in pixels.
    positions : Path or None
        Positions by file name, instead of EXIF.
    copy : bool
        Copy what lies outside the map's folder into it.
    force : bool
        Replace a map that is there already; photos that it has keep their ids.
    """

    cfg: Path
    satellite: Path | None = None
    source: GeoSource | None = None
    positions: Path | None = None
    copy: bool = False
    force: bool = False


@dataclass(frozen=True, slots=True)
class PlaceReport:
    """Every file of the folder, and how the image was georeferenced.

    Attributes
    ----------
    written : bool
        False when no photo could be placed: then there is no map.
    residuals_m : tuple of float
        Of the control points, metres.
    """

    cfg: Path
    written: bool
    satellite: SatelliteImage | None
    files: tuple[FileResult, ...]
    residuals_m: tuple[float, ...] = ()
    warnings: tuple[str, ...] = ()

    def count(self, state: FileState) -> int:
        """Count the files that became `state`."""
        return sum(file.state is state for file in self.files)


def map_from_photos(
    folder: Path, *, options: PlaceOptions, settings: Settings, progress: Progress
) -> PlaceReport:
    """Make a map from the photos of a folder.

    Parameters
    ----------
    folder : Path
        Searched with all folders below it.
    progress : Progress
        One step a file.

    Returns
    -------
    PlaceReport
        Lists every file, placed or not.

    Raises
    ------
    UsageError
        The request cannot work: the map exists, photos or image lie outside its folder, no georeference ...
    GeoreferenceError, TableError
        The georeference or the positions cannot be read.
    MapError
        The map to replace cannot be read, or the positions' `.cfg`.
    PhotoError
        The satellite image cannot be read.
    StorageError
        The disk refused.
    """
    target = NewMapFolder(options.cfg, folder, copy=options.copy)
    target.check(force=options.force, satellite=options.satellite)
    before = read_map(options.cfg) if options.cfg.exists() else None
    positions = read_positions(options.positions) if options.positions else None
    _check_sources(options, positions)
    # the image comes before the photos: a mistake in it shows at once
    image = _georeferenced(options.satellite, options.source) if options.satellite else None
    _check_same_image(positions, image)
    names = list_files(folder, leave_out=[options.cfg.parent / DERIVED])
    own = [options.satellite] if options.satellite else [target.plan_path]
    seen = survey(folder, names, positions=positions, limits=settings.photo, progress=progress)
    seen = [_own_file(s) if target.same(folder / s.name, own) else s for s in seen]
    plan = None
    if image is None:
        latlon = [s.position for s in seen if isinstance(s.position, LatLon)]
        if not latlon:
            return PlaceReport(options.cfg, False, None, tuple(unplaced(s) for s in seen))
        plan = plan_around(latlon)
        image = MapImage(plan.width, plan.height, plan.georeference, warnings=_far_apart(plan))
    placed = [place(s, image, photo=target.photo_name(s.name)) for s in seen]
    files, next_id = with_ids(placed, before)
    experiences = tuple(f.experience for f in files if f.experience is not None)
    satellite = SatelliteImage(target.image_name(options.satellite), image.width, image.height)
    if experiences:
        revision = before.revision + 1 if before else 0
        map_ = Map(satellite, experiences, image.georeference, next_id=next_id, revision=revision)
        originals = {f.experience.photo: f.name for f in files if f.experience is not None}
        target.write(map_, originals=originals, satellite=options.satellite, plan=plan)
    written = bool(experiences)
    return PlaceReport(options.cfg, written, satellite, tuple(files), image.residuals_m, image.warnings)


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


def _georeferenced(satellite: Path, source: GeoSource | None) -> MapImage:
    width, height = image_size(satellite)
    if source is None:
        return MapImage(width, height, None)
    fit = georeference_image.georeference_image(satellite, source, width=width, height=height)
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


def _own_file(surveyed: Surveyed) -> Surveyed:
    return Surveyed(surveyed.name, state=FileState.NOT_A_PHOTO, reason="it is the map's own image")


def _far_apart(plan: BlankPlan) -> tuple[str, ...]:
    extent = max(plan.width, plan.height) * plan.metres_per_pixel
    if extent < _FAR_M:
        return ()
    return (f"the photos are spread over {extent / 1000:.0f} km: is the position of some of them wrong?",)
