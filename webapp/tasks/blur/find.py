"""Finds faces and number plates in photos that are not blurred yet; nothing is changed."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from webapp.core.blur import BlurBox
from webapp.core.detections import Detection, join_same, to_blur
from webapp.core.mapmodel.model import Experience, UnplacedPhoto
from webapp.errors import MapError, MissingPart, PhotoError
from webapp.files.localize.blur_networks import BlurNetworks
from webapp.files.maps.folder import photo_path, read_map
from webapp.files.part_file import show_file_as
from webapp.files.photos.photo import read_upright
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.blur.kept import KeptFindings
from webapp.tasks.maps.show_photo import MOST_BOXES


@dataclass(frozen=True, slots=True)
class SuggestedBoxes:
    """What is suggested to be blurred in a photo, besides what is blurred already; boxes have margins."""

    id: int
    photo: str
    boxes: tuple[Detection, ...]


@dataclass(frozen=True, slots=True)
class UnsearchedPhoto:
    """A photo that could not be searched or blurred."""

    id: int
    photo: str
    reason: str


@dataclass(frozen=True, slots=True)
class BlurReport:
    """What was found in the photos of a map.

    Attributes
    ----------
    suggested : tuple of SuggestedBoxes
        Of photos in which there is something to blur, by id.
    searched : int
        How many photos were searched, now or before.
    """

    suggested: tuple[SuggestedBoxes, ...]
    failed: tuple[UnsearchedPhoto, ...]
    searched: int


def search_photo(
    file: Path, *, networks: BlurNetworks, kept: KeptFindings, limits: PhotoLimits
) -> list[Detection]:
    """Find faces and plates in a photo, unless that was done before; the surest first.

    Raises
    ------
    PhotoError
        The photo is damaged or cannot be read.
    StorageError
    """
    data = _read(file)
    sha256 = hashlib.sha256(data).hexdigest()
    known = kept.read().get(sha256)
    return _search(data, sha256, networks=networks, kept=kept, limits=limits) if known is None else known


def search_map(
    cfg: Path, *, networks: BlurNetworks, limits: PhotoLimits, progress: Progress, least_score: float = 0.0
) -> BlurReport:
    """Find faces and plates in all photos of a map, those in its tray included.

    Each photo that has been searched is kept, so that the work goes on where it stopped.

    Parameters
    ----------
    least_score : float
        What is less sure is not suggested.

    Raises
    ------
    MapError, StorageError, Cancelled
    """
    the_map = read_map(cfg)
    everything: list[Experience | UnplacedPhoto] = [*the_map.experiences, *the_map.unplaced]
    photos = sorted(everything, key=lambda one: one.id)
    kept = KeptFindings(cfg.parent, networks.key)
    known = kept.read()
    progress.size(len(photos))
    suggested: list[SuggestedBoxes] = []
    failed: list[UnsearchedPhoto] = []
    for one in photos:
        progress.check()
        try:
            with show_file_as(one.photo):
                data = _read(photo_path(cfg, one.photo))
                sha256 = hashlib.sha256(data).hexdigest()
                if sha256 not in known:
                    known[sha256] = _search(data, sha256, networks=networks, kept=kept, limits=limits)
        except (PhotoError, MapError, MissingPart) as error:  # a link out of the folder; a format's extra
            failed.append(UnsearchedPhoto(one.id, one.photo, error.message))
        else:
            boxes = suggestions(known[sha256], blurred=one.blurred, least_score=least_score)
            if boxes:
                suggested.append(SuggestedBoxes(one.id, one.photo, tuple(boxes)))
        progress.advance()
    return BlurReport(tuple(suggested), tuple(failed), len(photos) - len(failed))


def suggestions(
    found: Iterable[Detection], *, blurred: Sequence[BlurBox], least_score: float = 0.0
) -> list[Detection]:
    """Return what is to be blurred besides what is, as boxes with margins; as many as a photo may have."""
    sure = [one for one in found if one.score >= least_score]
    return to_blur(sure, blurred=blurred)[: max(0, MOST_BOXES - len(blurred))]


def _search(
    data: bytes, sha256: str, *, networks: BlurNetworks, kept: KeptFindings, limits: PhotoLimits
) -> list[Detection]:
    pixels = read_upright(data, limits=limits)
    found = join_same(one for detector in networks.detectors for one in detector.detect(pixels))
    kept.add(sha256, found)
    return found


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise PhotoError(f"cannot be read: {error.strerror}") from error
