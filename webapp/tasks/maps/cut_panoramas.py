"""Cuts panoramas into level perspective views, which are ordinary photos."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from webapp.core.geo.types import LatLon
from webapp.core.geometry.equirectangular import ViewSize, cut_view, view_size
from webapp.core.mapmodel.panorama import FOCAL_35MM, VIEWS
from webapp.errors import PhotoError, UsageError
from webapp.files.listing import list_photos
from webapp.files.photos.exif_gps import Gps
from webapp.files.photos.exif_write import CameraTags, write_view
from webapp.files.photos.panorama import GREY, PanoramaTags, read_panorama
from webapp.files.photos.photo import PhotoFacts, read_facts, read_file, read_upright
from webapp.progress import Progress
from webapp.settings import PhotoLimits


@dataclass(frozen=True, slots=True)
class CutOptions:
    """How panoramas are cut."""

    views: int = VIEWS  # Number of views, evenly spaced; the first is at the middle of the panorama
    # 35 mm equivalent focal length of each view, mm; 17 corresponds to 91 degrees.
    focal_35mm: int = FOCAL_35MM
    lowest_deg: float = 90.0  # Parts farther below the horizon are masked (robot, tripod)
    highest_deg: float = 90.0  # Parts farther above it are masked (sky)
    # Treat all photos twice as wide as high as panoramas, even without panorama metadata.
    assume: bool = False


@dataclass(frozen=True, slots=True)
class PanoramaPose:
    """Position of a panorama and heading of its middle, degrees clockwise from north; None if unknown."""

    position: LatLon | None = None
    heading_deg: float | None = None
    accuracy_m: float | None = None
    taken_at: str | None = None


@dataclass(frozen=True, slots=True)
class CutPhoto:
    """Result for a photo of the folder: the views that were written, or why there are none."""

    photo: str
    views: tuple[str, ...] = ()
    problem: str = ""


def cut_panoramas(
    folder: Path, out: Path, *, options: CutOptions, limits: PhotoLimits, progress: Progress
) -> Iterator[CutPhoto]:
    """Cut the panoramas of a folder and its subfolders; yield each photo when its views are written.

    Raises:
        UsageError: There is no photo, or the views would be among the panoramas.
        StorageError, Cancelled
    """
    if out.resolve().is_relative_to(folder.resolve()):
        raise UsageError(
            "the views would be among the panoramas", where=str(out), hint="choose another folder"
        )
    names = list_photos(folder)
    if not names:
        raise UsageError("there is no photo in it", where=str(folder))
    progress.size(len(names))
    taken: set[Path] = set()
    for name in names:
        progress.check()
        try:
            if (views := (out / name).with_suffix("")) in taken:
                raise PhotoError("its views would have the same names as those of another photo")
            taken.add(views)
            cut = cut_panorama(folder / name, out / name, options=options, limits=limits)
            yield CutPhoto(name, tuple(cut))
        except PhotoError as error:
            yield CutPhoto(name, problem=error.message)
        progress.advance()


def view_turns(options: CutOptions) -> tuple[int, ...]:
    """Return the rotations of the views from the middle of the panorama, degrees, as in their names."""
    return tuple(round(360.0 * number / options.views) for number in range(options.views))


def cut_panorama(
    path: Path, out: Path, *, options: CutOptions, limits: PhotoLimits, pose: PanoramaPose | None = None
) -> Iterator[str]:
    """Cut one panorama; yield the name of each view when it is written, in the order of `view_turns`.

    Args:
        out: `NAME.jpg` for views such as `NAME_060.jpg`; its folder is created.
        pose: Used instead of the pose in the file.

    Raises:
        PhotoError: It is damaged, or not a full panorama.
        StorageError
    """
    content = read_file(path, limits=limits)
    facts = read_facts(content, limits=limits)
    pixels = read_upright(content, limits=limits)
    size = pixels.shape[1], pixels.shape[0]
    panorama = read_panorama(content, size)
    if not panorama.is_whole:
        raise PhotoError("it is not a full panorama, twice as wide as high")
    if not (panorama.is_marked or options.assume):
        raise PhotoError("it is not marked as a panorama")
    known = pose or _pose_in_file(facts, panorama)
    view = view_size(size[0], options.focal_35mm)
    for number in range(options.views):
        turn = 360.0 * number / options.views
        cut, elevation = cut_view(pixels, view, turn_deg=turn)
        cut[(elevation < -options.lowest_deg) | (elevation > options.highest_deg)] = GREY
        file = out.with_name(f"{out.stem}_{round(turn):03}.jpg")
        write_view(file, cut, tags=_tags(known, view, turn_deg=turn))
        yield file.name


def _pose_in_file(facts: PhotoFacts, panorama: PanoramaTags) -> PanoramaPose:
    middle = panorama.heading_deg
    if middle is None and facts.heading is not None and facts.heading.reference != "M":
        middle = facts.heading.deg
    if not isinstance(facts.gps, Gps):
        return PanoramaPose(heading_deg=middle, taken_at=facts.taken_at)
    at = LatLon(facts.gps.lat, facts.gps.lon)
    return PanoramaPose(at, middle, facts.gps.accuracy_m, facts.taken_at)


def _tags(pose: PanoramaPose, view: ViewSize, *, turn_deg: float) -> CameraTags:
    return CameraTags(
        None if pose.taken_at is None else datetime.fromisoformat(pose.taken_at),
        view.focal_35mm,
        position=pose.position,
        heading_deg=None if pose.heading_deg is None else (pose.heading_deg + turn_deg) % 360.0,
        accuracy_m=pose.accuracy_m,
    )
