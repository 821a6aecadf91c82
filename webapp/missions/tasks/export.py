"""Exports a mission as a download in all formats, and answers queries on its rows."""

from __future__ import annotations

import io
import json
import tempfile
import unicodedata
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import IO, Any, Literal

from PIL import Image, ImageDraw, ImageFont

from webapp.errors import NotFound, PhotoError, UsageError
from webapp.files.exchange.zip_stream import ZipMember, stream_zip
from webapp.files.photos.photo import Kind
from webapp.missions.core.trajectory import symbols
from webapp.missions.core.trajectory.outgoing import MissionExport
from webapp.missions.core.trajectory.symbols import Line, kind_colour, symbol_of
from webapp.missions.files.csv_writer import csv_lines, format_objects_csv, format_poses_csv
from webapp.missions.files.geojson_writer import format_mission_geojson
from webapp.missions.files.gpx_writer import format_mission_gpx
from webapp.missions.files.kml_writer import format_mission_kml, format_network_link
from webapp.missions.files.trajectory_writer import format_kitti_zip, format_tum_zip
from webapp.missions.store import missions, reading
from webapp.missions.store.query import ParsedQuery, Question, answer, parse_question
from webapp.missions.tasks import add_photo
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.tasks.exchange.export_source import Download, plain_name
from webapp.tasks.maps.pictures import give_picture

Writer = Callable[[MissionExport], Iterator[bytes]]

_WRITERS: dict[str, tuple[str, Writer]] = {
    "gpx": ("application/gpx+xml", format_mission_gpx),
    "geojson": ("application/geo+json", format_mission_geojson),
    "csv": ("text/csv; charset=utf-8", format_poses_csv),
    "objects.csv": ("text/csv; charset=utf-8", format_objects_csv),
    "tum.zip": ("application/zip", format_tum_zip),
    "kitti.zip": ("application/zip", format_kitti_zip),
}

FORMATS = ("kml", "kmz", *_WRITERS)

KML = "application/vnd.google-earth.kml+xml"
KMZ = "application/vnd.google-earth.kmz"
LIVE_POSES = 2000
"""Maximum number of poses of each track in a live link, which programs redraw every few seconds."""

_BYTES_A_POSE = 120
_LARGE_BYTES = 1_500_000_000

SIDE = 64
"""Width and height, pixels."""

_FINE = 4
"""Factor by which icons are drawn larger and then scaled down, for smooth edges."""

_SCALE = SIDE * _FINE / symbols.SIDE
_INK = "#14181a"
_RIM = "#ffffff"


def export_mission(
    library: Library,
    mission_id: int,
    *,
    form: str,
    most: int | None = None,
    pictures: Settings | None = None,
    people: bool = False,
) -> Download:
    """Export a mission, using a few megabytes of memory regardless of its size.

    Args:
        form: One of `FORMATS`: `csv` has the poses, `objects.csv` the objects.
        most: Maximum number of poses of each track, evenly spread.
        pictures: If given, a KMZ includes previews of the photos of objects, without EXIF.
        people: Include the names of people who have set the states of objects.

    Returns:
        The current content of the mission. Its pieces raise `Conflict` if a track is rewritten meanwhile.

    Raises:
        UsageError: The format is unknown.
        NotFound: The mission does not exist.
    """
    if form not in FORMATS:
        raise UsageError(f"unknown export format {form!r}", where="format", hint=f"use {', '.join(FORMATS)}")
    mission = reading.read(library.database, mission_id, most=most, people=people)
    if form == "kml":
        return export_mission_kml(mission)
    if form == "kmz":
        find = (
            None
            if pictures is None
            else partial(find_picture, library, mission_id=mission_id, settings=pictures)
        )
        return export_mission_kmz(mission, picture=find)
    media_type, write = _WRITERS[form]
    joint = "-" if form == "objects.csv" else "."
    return Download(f"{plain_name(mission.name)}{joint}{form}", media_type, write(mission))


def find_picture(
    library: Library, sha256: str, *, mission_id: int, settings: Settings, kind: Kind = "preview"
) -> Path | None:
    """Find a picture of a photo, without metadata; None if it was never received, or is damaged."""
    try:
        with library.database.read() as session:
            photo = missions.find_photo(session, mission_id, sha256)
        file = add_photo.file_of(library, photo)
        return give_picture(library, file, kind=kind, audience="visitors", settings=settings).path
    except (NotFound, PhotoError):
        return None


def export_mission_kml(mission: MissionExport) -> Download:
    """Return a mission as KML, with objects as coloured pins."""
    return Download(f"{plain_name(mission.name)}.kml", KML, format_mission_kml(mission))


def export_mission_kmz(
    mission: MissionExport, *, picture: Callable[[str], Path | None] | None = None
) -> Download:
    """Return a mission as KMZ, which includes icons for the classes of its objects.

    Args:
        picture: Finds a picture of a photo, without metadata, by its SHA-256; may return None. If not given,
            the KMZ has no photos.
    """
    pieces = stream_zip(_members(mission, picture or (lambda _sha: None)))
    return Download(f"{plain_name(mission.name)}.kmz", KMZ, pieces)


def export_network_link(name: str, *, href: str, refresh_s: float) -> Download:
    """Return a KML network link that makes programs fetch `href` every `refresh_s` seconds.

    Args:
        name: Name of the mission.
        href: Absolute address of a KML or KMZ.
    """
    link = format_network_link(name, href=href, refresh_s=refresh_s)
    return Download(f"{plain_name(name)}-live.kml", KML, iter([link]))


def _members(mission: MissionExport, picture: Callable[[str], Path | None]) -> Iterator[ZipMember]:
    """Yield pictures and icons, then the KML, which refers to the pictures found."""
    photos: dict[str, str] = {}
    for sha in dict.fromkeys(found.photo for found in mission.objects() if found.photo):
        path = picture(sha)
        if path is not None:
            photos[sha] = f"photos/{sha}{path.suffix}"
            yield ZipMember(photos[sha], path)
    icons = {kind: f"icons/{number}.png" for number, kind in enumerate(mission.kinds)}
    for kind, name in icons.items():
        yield ZipMember(name, icon(kind))
    kml = format_mission_kml(mission, icons=icons, photos=photos)
    bytes_about = _BYTES_A_POSE * sum(track.count for track in mission.tracks)
    yield ZipMember("doc.kml", kml, large=bytes_about > _LARGE_BYTES)


def icon(kind: str) -> bytes:
    """Draw the symbol of a class of objects.

    Args:
        kind: Any text; a class without its own symbol shows its first letter, or a dot.

    Returns:
        PNG, `SIDE` x `SIDE`, transparent around the symbol, whose centre marks the position.
    """
    picture = Image.new("RGBA", (SIDE * _FINE, SIDE * _FINE))
    pen = ImageDraw.Draw(picture)
    symbol = symbol_of(kind)
    outline = symbols.DISC if symbol is None else symbol.frame.outline
    _stroke(pen, outline, _RIM, width=3.5, closed=True)
    pen.polygon(_scaled(outline), fill=kind_colour(kind))
    _stroke(pen, outline, _INK, width=1.5, closed=True)
    if symbol is None:
        _letter(pen, kind)
    else:
        for line in symbol.glyph:
            _stroke(pen, line, _INK, width=1.8)
    file = io.BytesIO()
    picture.resize((SIDE, SIDE), Image.Resampling.LANCZOS).save(file, "PNG", optimize=True)
    return file.getvalue()


def _scaled(line: Line) -> list[tuple[float, float]]:
    return [(x * _SCALE, y * _SCALE) for x, y in line]


def _stroke(pen: ImageDraw.ImageDraw, line: Line, ink: str, *, width: float, closed: bool = False) -> None:
    """Draw a line with round joints and ends."""
    points = _scaled((*line, line[0]) if closed else line)
    pen.line(points, fill=ink, width=round(width * _SCALE), joint="curve")
    radius = width * _SCALE / 2
    for x, y in points:
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=ink)


def _letter(pen: ImageDraw.ImageDraw, kind: str) -> None:
    """Draw the first letter, or a dot if it is not an ASCII letter or digit."""
    plain = unicodedata.normalize("NFKD", kind.strip()[:1]).encode("ascii", "ignore").decode()
    letter = plain[:1].upper()
    ((x, y),) = _scaled(((symbols.SIDE / 2, symbols.SIDE / 2),))
    if not letter.isalnum():
        radius = 3 * _SCALE
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_RIM)
        return
    font = ImageFont.load_default(size=16 * _SCALE)
    pen.text((x, y), letter, fill=_RIM, font=font, anchor="mm")


Form = Literal["json", "csv"]

_IN_MEMORY = 1 << 20
_PIECE = 1 << 16
_TYPES = {"json": "application/json", "csv": "text/csv; charset=utf-8"}


def query_mission(library: Library, mission_id: int, *, question: Question, form: Form) -> Download:
    """Answer a query.

    The whole answer is written to a temporary file before its first byte is sent: an error or a limit never
    results in a truncated answer, and a slow client does not block the database.

    Args:
        form: `json`: `columns`, `rows` (a list each) and `complete`, false if the limit cut off rows. `csv`:
            a header line, then the rows. Times are seconds since 1970, UTC.

    Raises:
        UsageError: The query is invalid, or takes too long.
    """
    asked = parse_question(mission_id, question)
    with ExitStack() as stack:
        file = stack.enter_context(tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY))
        with library.database.read() as session, closing(answer(session, asked)) as rows:
            if form == "json":
                _write_json(file, asked, rows, limit=question.limit)
            else:
                _write_csv(file, asked, rows, limit=question.limit)
        file.seek(0)
        stack.pop_all()
    return Download(f"{question.table}.{form}", _TYPES[form], _Pieces(file))


class _Pieces(Iterator[bytes]):
    """The content of a file, which is closed at its end or by `close`."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def __next__(self) -> bytes:
        piece = b"" if self._file.closed else self._file.read(_PIECE)
        if not piece:
            self.close()
            raise StopIteration
        return piece

    def close(self) -> None:
        self._file.close()


def _write_json(file: IO[bytes], asked: ParsedQuery, rows: Iterator[tuple[Any, ...]], *, limit: int) -> None:
    file.write(f'{{"columns": {json.dumps(asked.columns)}, "rows": ['.encode())
    complete = True
    for number, row in enumerate(rows):
        if number == limit:
            complete = False
            break
        comma = "," if number else ""
        file.write(f"{comma}\n{json.dumps(row, ensure_ascii=False)}".encode("utf-8", "replace"))
    file.write(f'\n], "complete": {json.dumps(complete)}}}\n'.encode())


def _write_csv(file: IO[bytes], asked: ParsedQuery, rows: Iterator[tuple[Any, ...]], *, limit: int) -> None:
    file.write(csv_lines([asked.columns]))
    for number, row in enumerate(rows):
        if number < limit:
            file.write(csv_lines([row]))
