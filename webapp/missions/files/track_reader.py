"""Every format of files with tracks; detects that of a file from its content, and reads it into pieces."""

from __future__ import annotations

import codecs
from collections.abc import Iterable, Iterator
from pathlib import Path

from webapp.errors import TrackError
from webapp.missions.files.readers import (
    ardupilot,
    csv_reader,
    fit,
    foxglove_mcap,
    geojson_reader,
    gpx,
    igc,
    kml_reader,
    nmea,
    rosbag,
    rtklib,
    tcx,
    trajectory_text,
    ulog,
)
from webapp.missions.files.track_chunks import Findings, Piece
from webapp.missions.files.track_format import Beginning, Selection, TrackFormat

FORMATS: dict[str, TrackFormat] = {
    entry.name: entry
    for entry in (
        foxglove_mcap.FORMAT,
        *rosbag.FORMATS,
        gpx.FORMAT,
        tcx.FORMAT,
        *kml_reader.FORMATS,
        geojson_reader.FORMAT,
        fit.FORMAT,
        ulog.FORMAT,
        *ardupilot.FORMATS,
        igc.FORMAT,
        nmea.FORMAT,
        rtklib.FORMAT,
        *trajectory_text.FORMATS,
        csv_reader.FORMAT,
    )
}
"""Formats by name, in the order in which they are listed, and in which a file is tried."""

_WIDE = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def called(entries: Iterable[TrackFormat]) -> list[str]:
    """Return how lists of formats call them, each word once."""
    return list(dict.fromkeys(entry.called for entry in entries))


def _sentence(entries: Iterable[TrackFormat], *, joint: str = "and") -> str:
    *most, last = called(entries)
    return f"{', '.join(most)} {joint} {last}" if most else last


def listed() -> str:
    return _sentence(FORMATS.values())


def with_axes() -> str:
    """List the formats whose axes can be chosen."""
    return _sentence(entry for entry in FORMATS.values() if entry.has_axes)


def accepted() -> str:
    """Return the endings of files of all formats, as a page's file field takes them."""
    return ",".join(dict.fromkeys(ending for entry in FORMATS.values() for ending in entry.endings))


def kind_of(path: Path, *, table: bool = False) -> TrackFormat:
    """Detect the format of a file, or of the folder of a ROS 2 bag.

    Args:
        table: Treat any text file as a table.

    Raises:
        TrackError: The file is not a track, cannot be read, or is XML that declares a document type.
    """
    try:
        if path.is_dir():
            return rosbag.folder_kind(path)
        beginning = Beginning(path)
    except OSError as error:
        message = f"the file cannot be read: {error.strerror or error}"
        raise TrackError(message, hint="check its path") from error
    if not beginning.head:
        raise TrackError("the file is empty")
    if table and beginning.is_text and not beginning.head.startswith(_WIDE):
        return csv_reader.FORMAT
    for entry in FORMATS.values():
        if beginning.root in entry.roots or entry.is_one(beginning):
            return entry
    raise _unknown(beginning)


def _unknown(beginning: Beginning) -> TrackError:
    hint = f"known are {listed()}"
    if beginning.root:
        roots = _sentence((e for e in FORMATS.values() if e.roots), joint="nor")
        return TrackError(f"the XML is neither {roots}: it begins with <{beginning.root[:40]}>", hint=hint)
    if beginning.head.startswith(_WIDE):
        return TrackError("the file is UTF-16 text", hint="save it as UTF-8")
    if not beginning.is_text:
        return TrackError("this is not a file with a track", hint=hint)
    return TrackError("the text has no known format", hint=hint)


def read(path: Path, kind: str, *, selection: Selection, findings: Findings) -> Iterator[Piece]:
    """Yield the pieces of a file, before they are georeferenced.

    Args:
        path: A file, or the folder of a ROS 2 bag.
        kind: Name of its format.

    Raises:
        TrackError: The file is damaged, or has no usable content.
        UsageError: The given columns do not fit the table.
    """
    yield from FORMATS[kind].read(path, selection, findings)
