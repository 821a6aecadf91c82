"""Every way to take a mission away, by its ending."""

from __future__ import annotations

from webapp.errors import UsageError
from webapp.missions.render import page
from webapp.missions.tasks import export
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.tasks.exchange.export_source import Download

FORMATS = (*export.FORMATS, "html")


def run(
    library: Library,
    mission_id: int,
    *,
    form: str,
    settings: Settings,
    most: int | None = None,
    photos: bool = False,
) -> Download:
    """Export a mission.

    Parameters
    ----------
    form : str
        One of `FORMATS`.
    most : int, optional
        At most so many poses of each track, evenly spread; a page has a limit of its own.
    photos : bool
        Whether a KMZ has previews of the photos of objects.

    Raises
    ------
    UsageError
        There is no such format, or the mission is too large for it.
    NotFound
        There is no such mission.
    """
    if form not in FORMATS:
        raise UsageError(f"there is no format {form!r}", where="format", hint=f"use {', '.join(FORMATS)}")
    if form == "html":
        return page.run(library, mission_id, settings=settings)
    return export.export_mission(
        library, mission_id, form=form, most=most, pictures=settings if photos else None
    )
