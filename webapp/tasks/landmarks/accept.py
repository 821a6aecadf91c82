"""Places photos where they are suggested: in the library as one edit, in any other folder in its files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from sqlalchemy import select

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience
from webapp.files.maps.folder import read_map, write_map
from webapp.store.accounts import accounts
from webapp.store.library import DATABASE, INNER, Library, open_library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks.place_rest import SuggestedPlace
from webapp.tasks.maps import export
from webapp.tasks.maps.placing import PlacingResult, RequestedPose, find_spots, needed_image, place_spots


@contextmanager
def library_of(cfg: Path) -> Iterator[tuple[Library, int] | None]:
    """Open the library that a map file belongs to, and give the map's id; None for one of any other folder.

    The file is brought up to date first.

    Raises
    ------
    StorageError
    """
    folder = cfg.resolve().parent
    if cfg.name != "map.cfg" or not (folder.parent / INNER / DATABASE).is_file():
        yield None
        return
    library = open_library(folder.parent)
    try:
        with library.database.read() as session:
            found = session.scalar(select(MapRecord.id).where(MapRecord.slug == folder.name))
        if found is not None:
            export.export_map(library, found)
        yield None if found is None else (library, found)
    finally:
        library.database.close()


def owner_of(library: Library) -> int:
    """Return the id of the account of the library's owner."""
    with library.database.write() as session:
        return accounts.ensure_owner(session).id


def accept_in_library(
    library: Library, map_id: int, *, suggested: Iterable[SuggestedPlace], account_id: int
) -> PlacingResult:
    """Place photos where they are suggested, as one edit; those that have a place by now stay where they are.

    Parameters
    ----------
    account_id : int
        Who does it, and can undo it.

    Raises
    ------
    UsageError
        The map has no satellite image any more.
    """
    places = {one.id: one for one in suggested}
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        image = needed_image(record, with_georeference=False)
        wanted = [
            RequestedPose(photo, MapPixel(*places[id].position), places[id].heading_deg)
            for id, photo in maps.photos_by_id(session, record, places).items()
            if not photo.removed and photo.x_px is None
        ]
        spots = find_spots(image, wanted)
        placing = place_spots(session, record, spots=spots, kind="place-rest", account_id=account_id)
    return replace(placing, job=change.job)


def accept_in_folder(cfg: Path, suggested: Sequence[SuggestedPlace]) -> None:
    """Place photos where they are suggested, in the files of a map that is in no library.

    Raises
    ------
    MapError, StorageError
    """
    the_map = read_map(cfg)
    places = {one.id: one for one in suggested}
    placed = [
        Experience(
            photo.id,
            photo.photo,
            places[photo.id].position,
            heading_deg=places[photo.id].heading_deg,
            fov_deg=photo.fov_deg,
            taken_at=photo.taken_at,
            name=photo.name,
            blurred=photo.blurred,
            source=photo.source,
            panorama=photo.panorama,
        )
        for photo in the_map.unplaced
        if photo.id in places
    ]
    changed = replace(
        the_map,
        experiences=tuple(sorted((*the_map.experiences, *placed), key=lambda e: e.id)),
        unplaced=tuple(photo for photo in the_map.unplaced if photo.id not in places),
    )
    write_map(cfg, changed)
