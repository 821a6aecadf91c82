"""Adds photos of a street-level service to a map; a killed run can be resumed."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path

from webapp.core.mapmodel.model import PhotoSource
from webapp.errors import InputError, PhotoError
from webapp.files.atomic import write_bytes
from webapp.files.lock import exclusive
from webapp.files.part_file import discard
from webapp.net.polite import PoliteClient
from webapp.net.street import StreetPhoto
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.maps.add_photo import ServiceMetadata
from webapp.tasks.maps.panoramas import PanoramaPose, cut_panorama, view_turns
from webapp.tasks.street.survey import (
    CUT,
    ArrivedPhoto,
    PlacedStreetPhoto,
    StreetRequest,
    StreetSurvey,
    StreetTarget,
    open_service,
    part_ids,
)
from webapp.threads import ContextThreads

_LISTEN_S = 0.5
"""Interval at which cancellation is checked while waiting for a photo."""

_FAILURES_IN_A_ROW = 3
"""Consecutive failures after which the service counts as down, and no further photos are requested."""


@dataclass(frozen=True, slots=True)
class FailedPhoto:
    id: str
    reason: str


@dataclass(frozen=True, slots=True)
class StreetReport:
    """The result for the photos that a map did not have."""

    added: int  # Number of photos; each view of a panorama is one
    duplicates: int  # Number of files that the map had under another name
    failed: tuple[FailedPhoto, ...] = ()


def add_street_photos(
    target: StreetTarget,
    survey: StreetSurvey,
    *,
    request: StreetRequest,
    settings: Settings,
    progress: Progress,
) -> StreetReport:
    """Download photos and add them, each as soon as it has arrived.

    Raises:
        NotFound: The service is no longer configured, or the map no longer exists.
        InputError: The service failed several times in a row; photos added before stay.
        TooMany: The service demands a long pause; photos added before stay.
        Busy: Photos are already being added to this map.
    """
    with exclusive(
        target.scratch("adding.lock"), doing="street-level photos are being added to this map already"
    ):
        return _add(target, survey, request=request, settings=settings, progress=progress)


def _add(
    target: StreetTarget,
    survey: StreetSurvey,
    *,
    request: StreetRequest,
    settings: Settings,
    progress: Progress,
) -> StreetReport:
    service, client = open_service(request.source, settings.street)
    known = target.known(service.name)
    progress.size(len(survey.wanted))
    progress.note(service.name)
    added = duplicates = in_a_row = 0
    failed: list[FailedPhoto] = []
    fetch = _Fetch(client, target, prefix=service.key, settings=settings)
    for placed, arrived in fetch.all(survey.wanted, progress=progress):
        problem = arrived if isinstance(arrived, InputError) else None
        if isinstance(arrived, Path):
            try:
                for part in _parts(placed, arrived, request=request, service=service.name, settings=settings):
                    if part.known.source.id in known:
                        discard(part.file)
                    elif target.take(part):
                        added += 1
                    else:
                        duplicates += 1
            except PhotoError as error:
                problem = error
            discard(arrived)
        in_a_row = in_a_row + 1 if isinstance(arrived, InputError) else 0
        if problem is not None:
            failed.append(FailedPhoto(placed.photo.id, problem.message))
        if in_a_row == _FAILURES_IN_A_ROW and isinstance(arrived, InputError):
            raise arrived
        progress.advance()
    return StreetReport(added, duplicates, tuple(failed))


class _Fetch:
    """Downloads photos, a few in parallel; one that is already on the disk is not requested again."""

    def __init__(
        self, client: PoliteClient, target: StreetTarget, *, prefix: str, settings: Settings
    ) -> None:
        self._client, self._target, self._prefix, self._settings = client, target, prefix, settings

    def all(
        self, photos: tuple[PlacedStreetPhoto, ...], *, progress: Progress
    ) -> Iterator[tuple[PlacedStreetPhoto, Path | InputError]]:
        """Yield each photo with its file or error, in the order of arrival."""
        todo = iter(photos)
        pool = ContextThreads(self._settings.street.parallel)
        running: dict[Future[Path], PlacedStreetPhoto] = {}
        try:
            while True:
                while len(running) < self._settings.street.parallel and (one := next(todo, None)):
                    running[pool.submit(self._one, one.photo)] = one
                if not running:
                    return
                for future in wait(running, timeout=_LISTEN_S, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), _path_or_error(future)
                progress.check()
        finally:
            self._client.stop()
            pool.shutdown(cancel_futures=True)

    def _one(self, photo: StreetPhoto) -> Path:
        file = self._target.scratch(f"{self._prefix}-{photo.id}.jpg")
        if not file.exists():
            most = int(self._settings.photo.max_mb * 1e6)
            write_bytes(file, self._client.photo(photo.address, max_bytes=most))
        return file


def _path_or_error(future: Future[Path]) -> Path | InputError:
    try:
        return future.result()
    except InputError as error:
        return error


def _parts(
    placed: PlacedStreetPhoto, file: Path, *, request: StreetRequest, service: str, settings: Settings
) -> Iterator[ArrivedPhoto]:
    """Yield a photo unchanged, or the views of a panorama."""
    photo = placed.photo
    name = f"{request.source}-{photo.id}"
    ids = part_ids(photo, request.panoramas)
    if len(ids) == 1:
        yield ArrivedPhoto(file, f"{name}.jpg", _known(photo, ids[0], service=service), placed.pixel)
        return
    pose = PanoramaPose(photo.position, photo.heading_deg, photo.accuracy_m, photo.taken_at)
    views = cut_panorama(file, file, options=CUT, limits=settings.photo, pose=pose)
    for id, turn, view in zip(ids, view_turns(CUT), views, strict=True):
        known = _known(photo, id, service=service, turn_deg=float(turn))
        yield ArrivedPhoto(file.with_name(view), f"{name}_{turn:03}.jpg", known, placed.pixel)


def _known(photo: StreetPhoto, id: str, *, service: str, turn_deg: float = 0.0) -> ServiceMetadata:
    heading = photo.heading_deg
    return ServiceMetadata(
        PhotoSource(service, id, photo.licence, photo.author, photo.page),
        photo.position,
        None if heading is None else (heading + turn_deg) % 360.0,
        photo.fov_deg,
        photo.accuracy_m,
        photo.taken_at,
    )
