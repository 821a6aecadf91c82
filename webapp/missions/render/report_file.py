"""The report of a mission as a file: a page for every browser, which prints well, or a PDF."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from webapp.errors import UsageError
from webapp.missions.render.ground import ground_of
from webapp.missions.render.report import NOTATIONS, ReportContent, write_content
from webapp.missions.render.report_map import draw_map
from webapp.missions.tasks import report
from webapp.missions.tasks.export import find_picture
from webapp.render.language import Language
from webapp.resources import resource_folder
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.tasks.exchange.export_source import Download, plain_name

FORMATS = ("report.html", "report.pdf")

_TYPES = {"report.html": "text/html; charset=utf-8", "report.pdf": "application/pdf"}
_IMAGES = {b"\xff\xd8": "jpeg", b"\x89P": "png", b"RI": "webp"}
"""First bytes of the formats of pictures."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What an export includes, and how a report is written."""

    most: int | None = (
        None  # Maximum number of poses of each track, evenly spread; pages have their own limit
    )
    # Include what visitors do not get: names of people, notes, robots; in a KMZ also pictures of objects.
    private: bool = False
    # `photos`, `language`, `zone`, `positions`: Of reports only.
    photos: bool = False  # Include small pictures of objects
    language: str = "en"  # One of `webapp.render.language.LANGUAGES`
    zone: str = "UTC"  # The time zone of its times, such as `Europe/Prague`
    positions: str = "degrees"  # Notation beside decimal degrees, one of `NOTATIONS`


def export_report(
    library: Library,
    mission_id: int,
    *,
    form: str,
    settings: Settings,
    options: ExportOptions,
) -> Download:
    """Make the report of a mission; its size is limited, however long the mission was.

    Args:
        form: One of `FORMATS`.

    Raises:
        NotFound: The mission does not exist.
        UsageError: The language, zone or notation is unknown.
    """
    if options.positions not in NOTATIONS:
        raise UsageError(
            f"there is no notation {options.positions!r}",
            where="positions",
            hint=f"use {', '.join(NOTATIONS)}",
        )
    words = Language(options.language, zone=options.zone)
    found = report.gather(library, mission_id, people=options.private)
    content = write_content(
        found,
        map_jpeg=draw_map(found, ground_of(library, mission_id, settings=settings)),
        picture=partial(_thumbnail, library, mission_id, settings=settings) if options.photos else None,
        language=words,
        positions=options.positions,
    )
    pieces = _page(content) if form == "report.html" else _pdf(content)
    return Download(f"{plain_name(found.mission.name)}-{form}", _TYPES[form], pieces)


def _thumbnail(library: Library, mission_id: int, sha256: str, *, settings: Settings) -> bytes | None:
    path = find_picture(library, sha256, mission_id=mission_id, kind="thumb", settings=settings)
    return None if path is None else path.read_bytes()


def _page(content: ReportContent) -> Iterator[bytes]:
    environment = Environment(
        loader=FileSystemLoader(resource_folder("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["data_uri"] = _data_uri
    stream = environment.get_template("missions/report.html").stream(report=content)
    stream.enable_buffering(200)
    return (piece.encode("utf-8", "replace") for piece in stream)


def _pdf(content: ReportContent) -> Iterator[bytes]:
    from webapp.missions.render.report_pdf import report_pdf  # loaded only where it is needed

    return iter([report_pdf(content)])


def _data_uri(picture: bytes) -> str:
    kind = _IMAGES[picture[:2]]
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode('ascii')}"
