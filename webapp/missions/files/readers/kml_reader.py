"""KML and KMZ of missions, reader: lines and gx:Track are tracks, points are objects.

`gx:Track` has a time for each position (KML 2.2 with Google's extension, `Track` in OGC KML 2.3); a
`LineString` has none. Network links are not followed.
"""

from __future__ import annotations

import io
import lzma
import math
import posixpath
import re
import zipfile
import zlib
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, BinaryIO, cast
from urllib.parse import unquote
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon
from webapp.errors import TrackError
from webapp.files.exchange.times import unix_time
from webapp.files.exchange.xml import child_text, local_name, number, walk
from webapp.files.exchange.zip_directory import has_many_files
from webapp.missions.core.looks import look_in_file
from webapp.missions.core.trajectory.records import SOURCES, Sighting, Source
from webapp.missions.files.drawn import found_drawing, kind_of_drawing, turned_lon
from webapp.missions.files.readers.kml_styles import STYLES, LineStyles
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint, mostly_timed
from webapp.missions.files.track_chunks import CHUNK, UNTIMED_OBJECTS, Findings, Piece, WorldObjects
from webapp.missions.files.track_format import Beginning, FormatAbout, Selection, TrackFormat, opened

MAX_LINES = 100
"""A KML with more lines is a drawing, not a recorded track."""

_UNUSED = {
    "Polygon": "areas, which are not tracks",
    "Model": "3D models, which are not tracks",
    "NetworkLink": "links to other files, which are not followed",
    "GroundOverlay": "images on the ground, which are not tracks",
}
_SHAPES = {"LinearRing", "LineString", "Point"}
_WORD = re.compile(r"\S+")

MAX_BYTES = 200_000_000
MAX_RATIO = 100
"""Compression of a KML: of recorded positions it is about 5, of repeated text up to 50."""

_SMALL = 1_000_000
_MAX_FILES = 10_000
"""Maximum number of files in a KMZ, including icons and pictures."""

_BROKEN = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError)
"""Exceptions of `zipfile` for damaged, encrypted and unsupported entries."""


@dataclass(frozen=True, slots=True)
class _Placemark:
    """Properties of a placemark that apply to all geometries in it."""

    number: int
    name: str
    time_s: float
    source: Source  # As our own export states it, else `gps`
    # `colour`, `width`: of lines, as far as the file states them.
    colour: str
    width: str


@dataclass(slots=True)
class _Found:
    """What was found so far: several documents of a KMZ are numbered as one."""

    marks: int = 0
    lines: int = 0
    links: list[str] | None = None  # Of the documents; None if they cannot be followed
    styles: LineStyles = field(default_factory=LineStyles)


def read(
    file: BinaryIO, *, findings: Findings, tracks: tuple[str, ...] = (), found: _Found | None = None
) -> Iterator[Piece]:
    """Read a KML file.

    Args:
        tracks: Names of the lines to read; empty for all.

    Raises:
        TrackError: The file is damaged, declares a document type, or has more than `MAX_LINES` lines to read.
    """
    found = found or _Found()
    for event, element in walk(file, whole={"Placemark", "NetworkLink", *STYLES}):
        name = local_name(element)
        if name == "NetworkLink":
            _link(element, found, findings=findings)
        elif name in STYLES:
            found.styles.add(element)
        elif event == "start" and name in _UNUSED:
            findings.skip(_UNUSED[name], where=f"<{name}>")
        if name != "Placemark":
            continue
        found.marks += 1
        title, data = " ".join(child_text(element, "name").split()), _data(element)
        source: Source = next((known for known in SOURCES if known == data.get("source")), "gps")
        mark = _Placemark(found.marks, title, _time(element), source, *found.styles.of(element))
        if _draw(element, mark, data, findings=findings):
            continue
        for part in element.iter():
            kind = local_name(part)
            if kind in _UNUSED:
                findings.skip(_UNUSED[kind], where=mark.name or f"placemark {found.marks}")
            elif kind == "Point":
                yield from _object(part, mark, findings=findings)
            elif kind in {"LineString", "Track"}:
                if tracks and mark.name not in tracks:
                    findings.skip("tracks that were not asked for", where=mark.name)
                    continue
                found.lines += 1
                if found.lines > MAX_LINES:
                    raise TrackError(
                        f"the file has more than {MAX_LINES} lines: it is a drawing, not a track",
                        hint="name the lines that are tracks",
                    )
                title = f"{mark.name or 'track'} {found.lines}"
                look = look_in_file(mark.name, mark.source, colour=mark.colour, width_px=mark.width)
                findings.looks[title] = look
                yield from _line(part, title, source=mark.source, findings=findings)


def _link(element: Element, found: _Found, *, findings: Findings) -> None:
    """Note a link to another document, or count it if it cannot be followed."""
    parts = (part for part in element.iter() if local_name(part) in ("Link", "Url"))
    href = next((child_text(part, "href") for part in parts), "")
    if found.links is None or not href or "://" in href:
        findings.skip(_UNUSED["NetworkLink"], where="<NetworkLink>")
    else:
        found.links.append(href.replace("\\", "/"))


def _line(part: Element, title: str, *, source: Source, findings: Findings) -> Iterator[Piece]:
    if local_name(part) == "Track":
        track = _track(part, findings=findings, where=title)
        points, timed = iter(track), mostly_timed(track)
    else:
        rows = _coordinates(child_text(part, "coordinates"), findings=findings, where=title)
        points, timed = _untimed(rows), False
    line = LineBuffer(title, timed=timed, source=source)
    for point in points:
        yield from line.add(point, findings=findings)
    yield from line.flush(findings)


def _untimed(rows: NDArray[np.float64]) -> Iterator[LinePoint]:
    for first in range(0, len(rows), CHUNK):
        for lon, lat, height in rows[first : first + CHUNK].tolist():
            yield LinePoint(math.nan, lat, lon, height)


def _track(part: Element, *, findings: Findings, where: str) -> list[LinePoint]:
    """Read a gx:Track: times, positions and angles are paired by index."""
    whens, coords, headings = [], [], []
    for child in part:
        text = (child.text or "").strip()
        match local_name(child):
            case "when":
                whens.append(unix_time(text))
            case "coord":
                values = [number(word) for word in text.split()[:3]]
                coords.append(values + [math.nan] * (3 - len(values)))
            case "angles":
                words = text.split()
                headings.append(number(words[0]) if words else math.nan)
    pairs = min(len(whens), len(coords)) if whens else len(coords)
    findings.skip(
        "times or positions of a track without their counterpart",
        where=where,
        count=max(len(whens), len(coords)) - pairs,
    )
    if len(headings) != len(coords):
        headings = [math.nan] * len(coords)
    times = whens[:pairs] if whens else [math.nan] * pairs
    return [
        LinePoint(time_s, lat, lon, height, heading)
        for time_s, (lon, lat, height), heading in zip(times, coords, headings, strict=False)
    ]


def _object(part: Element, mark: _Placemark, *, findings: Findings) -> Iterator[Piece]:
    where = mark.name or f"placemark {mark.number}"
    rows = _coordinates(child_text(part, "coordinates"), findings=findings, where=where)
    if not len(rows):
        findings.skip("points without a position", where=where)
        return
    lon, lat, height = rows[0].tolist()
    name = f"placemark {mark.number} {mark.name}".strip()
    time_s = 0.0 if math.isnan(mark.time_s) else mark.time_s
    if math.isnan(mark.time_s):
        findings.note(UNTIMED_OBJECTS)
    at = None if math.isnan(height) else height
    yield WorldObjects((Sighting(name, "placemark", time_s, LatLon(lat, lon), at),))


def _data(placemark: Element) -> dict[str, str]:
    """Return the extended data of a placemark."""
    data = (element for element in placemark.iter() if local_name(element) == "Data")
    return {element.get("name", ""): child_text(element, "value") for element in data}


def _draw(placemark: Element, mark: _Placemark, data: dict[str, str], *, findings: Findings) -> bool:
    """Read a search area, a line or a marker of our own export; return whether it is one."""
    about = {"name": mark.name} | data
    kind = kind_of_drawing(about)
    if kind is None:
        return False
    where = mark.name or f"placemark {mark.number}"
    texts = [child_text(part, "coordinates") for part in placemark.iter() if local_name(part) in _SHAPES]
    rows = _coordinates(texts[0] if len(texts) == 1 else "", findings=findings, where=where)
    shape = [(lat, turned_lon(lon)) for lon, lat, _ in rows.tolist()]
    findings.draw(found_drawing(kind, about, points=shape), where=where)
    return True


def _time(placemark: Element) -> float:
    """Return the time of a placemark: its time stamp, or the begin of its time span; NaN if unknown."""
    for element in placemark.iter():
        if local_name(element) in {"TimeStamp", "TimeSpan"}:
            return unix_time(child_text(element, "when") or child_text(element, "begin"))
    return math.nan


def _coordinates(text: str, *, findings: Findings, where: str) -> NDArray[np.float64]:
    """Parse `lon,lat[,height]` positions: (n, 3) float64, NaN for missing or invalid numbers.

    If blanks between positions are missing, the numbers are split into triples, as in Google Earth.
    """
    rows = array("d")
    plain = " ".join(text.split()).replace(" ,", ",").replace(", ", ",")
    for word in _WORD.finditer(plain):
        fields = [number(field) for field in word[0].split(",")]
        if len(fields) > 3 and len(fields) % 3 == 0:
            findings.note("positions without blanks between them were read as longitude, latitude, height")
            rows.extend(fields)
        else:
            rows.extend((fields + [math.nan] * 3)[:3])
    return np.frombuffer(rows, dtype=np.float64).reshape(-1, 3)


@contextmanager
def opened_kml(path: Path) -> Iterator[BinaryIO]:
    """Open the KML of a KMZ: `doc.kml`, or else the first one.

    Raises:
        TrackError: The file is not a zip, has no KML, is encrypted or damaged, or declares an implausible
            uncompressed size; also raised while the KML is read.
    """
    with _archive(path) as archive, _opened_entry(archive, _kml(archive)) as file:
        yield file


@contextmanager
def _archive(path: Path) -> Iterator[zipfile.ZipFile]:
    if has_many_files(path, limit=_MAX_FILES):
        raise TrackError(f"the zip has more than {_MAX_FILES} files", hint="export the track again")
    try:
        archive = zipfile.ZipFile(path)
    except _BROKEN as error:
        raise TrackError(f"the zip is damaged: {str(error)[:200]}") from error
    with archive:
        yield archive


@contextmanager
def _opened_entry(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Iterator[BinaryIO]:
    if info.file_size > MAX_BYTES or info.file_size > _SMALL + MAX_RATIO * info.compress_size:
        raise TrackError(
            f"the zip claims to hold {info.file_size / 1e6:.0f} MB in {info.compress_size} bytes",
            hint="export the track again",
        )
    try:
        packed = archive.open(info)
    except _BROKEN as error:
        raise TrackError(f"the zip is damaged or encrypted: {str(error)[:200]}") from error
    with packed:
        # zipfile never returns more bytes than the declared size of an entry
        yield cast(BinaryIO, io.BufferedReader(_CheckedEntry(packed)))


def _kml(archive: zipfile.ZipFile) -> zipfile.ZipInfo:
    found = [info for info in archive.infolist() if info.filename.lower().endswith(".kml")]
    if not found:
        raise TrackError("the zip has no KML", hint="a KMZ has a doc.kml in it")
    return next((info for info in found if info.filename.lower() == "doc.kml"), found[0])


class _CheckedEntry(io.RawIOBase):
    """The bytes of an entry; damage raises `TrackError`."""

    def __init__(self, packed: IO[bytes]) -> None:
        self._packed = packed

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        try:
            data = self._packed.read(len(buffer))
        except _BROKEN as error:
            raise TrackError(f"the zip is damaged: {str(error)[:200]}") from error
        buffer[: len(data)] = data
        return len(data)


def _is_kmz(beginning: Beginning) -> bool:
    """Detect by the first bytes; every zip counts as a KMZ, and one without a KML is refused."""
    if not beginning.head.startswith(b"PK\x03\x04"):
        return False
    if not zipfile.is_zipfile(beginning.path):
        raise TrackError("the zip is damaged or cut off")
    with opened_kml(beginning.path):
        return True


def _read_kmz(path: Path, selection: Selection, findings: Findings) -> Iterator[Piece]:
    """Read the first document of a KMZ, and those in it to which its links lead."""
    found = _Found(links=[])
    with _archive(path) as archive:
        first = _kml(archive)
        names = {info.filename: info for info in archive.infolist()}
        waiting, seen, most = [first], {first.filename}, MAX_BYTES
        while waiting:
            info = waiting.pop(0)
            most -= info.file_size
            if len(seen) > MAX_LINES or most < 0:
                raise TrackError("the documents of the KMZ that it links to are too many or too large")
            with _opened_entry(archive, info) as file:
                yield from read(file, findings=findings, tracks=selection.topics, found=found)
            links, found.links = found.links or [], []
            for link in links:
                name = posixpath.normpath(posixpath.join(posixpath.dirname(info.filename), _file_of(link)))
                if name in names and name not in seen and name.lower().endswith(".kml"):
                    seen.add(name)
                    waiting.append(names[name])
                elif name not in seen:
                    findings.skip(_UNUSED["NetworkLink"], where="<NetworkLink>")


def _file_of(link: str) -> str:
    return unquote(link.partition("#")[0].partition("?")[0].strip())


_KML = TrackFormat(
    "kml",
    "KML",
    "KML",
    endings=(".kml",),
    roots=frozenset({"kml", "Document", "Folder", "Placemark", "NetworkLink"}),
    read=opened(lambda file, selection, findings: read(file, findings=findings, tracks=selection.topics)),
    numbered="placemark",
    about=FormatAbout(
        tracks=f"`gx:Track`, `gx:MultiTrack`, `LineString`; at most {MAX_LINES} lines, unless some are named",
        objects="points",
        left_out="areas, models, images; network links are not followed",
        written_by="Google Earth, loggers, drone planners",
    ),
)
_KMZ = replace(
    _KML,
    name="kmz",
    title="KMZ",
    called="KMZ",
    endings=(".kmz", ".zip"),
    is_one=_is_kmz,
    roots=frozenset(),
    read=_read_kmz,
    about=replace(
        _KML.about,
        tracks="as KML: its `doc.kml`, or else the first one, and those in it to which it links",
    ),
)
FORMATS = (_KML, _KMZ)
