"""GPX tracks: the fixes that have times."""

from __future__ import annotations

import re
from datetime import UTC
from pathlib import Path

import gpxpy
from gpxpy.gpx import GPX, GPXException

from webapp.core.geo.types import LatLon
from webapp.core.trajectory.track import Track, make_track
from webapp.errors import TrackError
from webapp.files.text_file import read_bytes

MAX_BYTES = 30_000_000
MAX_FIXES = 200_000
_NOT_GPX = re.compile(r"<!(DOCTYPE|ENTITY)", re.IGNORECASE)
_DECLARATION = re.compile(r"^\s*<\?xml[^>]*\?>")
_ENCODING = re.compile(rb"^\s*<\?xml[^>]*encoding\s*=\s*[\"']([A-Za-z0-9._-]{1,20})[\"']")
_CODECS = {"utf-8", "us-ascii", "ascii", "iso-8859-1", "iso-8859-2", "windows-1250", "windows-1252"}
_BOMS = ((b"\xef\xbb\xbf", "utf-8-sig"), (b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"))


def read_gpx(path: Path) -> Track:
    """Read the tracks of a GPX file (1.0 or 1.1) as one.

    Fixes without a time, and positions that are none on the Earth, are left out; so are routes and waypoints.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Track
        Of at least two fixes.

    Raises
    ------
    TrackError
        The file cannot be read, is too large, is no GPX, declares a document type (which can blow up a
        reader's memory), or has fewer than two fixes with times.
    """
    try:
        return parse_gpx(read_bytes(path, error=TrackError))
    except TrackError as error:
        raise TrackError(error.message, where=str(path), hint=error.hint) from error


def parse_gpx(data: bytes) -> Track:
    """Read the content of a GPX file; see `read_gpx`."""
    if len(data) > MAX_BYTES:
        raise TrackError(
            f"the file is larger than {MAX_BYTES // 10**6} MB", hint="export a part of the track"
        )
    text = _text(data)
    if _NOT_GPX.search(text):
        raise TrackError("the file declares a document type, which no GPX needs", hint="export it again")
    if text.count("trkpt ") > MAX_FIXES:
        raise TrackError(f"the track has more than {MAX_FIXES} points", hint="export a part of it")
    try:
        return _track(gpxpy.parse(_DECLARATION.sub("", text)))
    except (GPXException, ValueError, AttributeError, TypeError, ArithmeticError, RecursionError) as error:
        raise TrackError(
            f"the file is no GPX: {_first_line(error)}", hint="export it again as GPX"
        ) from error


def _track(gpx: GPX) -> Track:
    points = [point for track in gpx.tracks for segment in track.segments for point in segment.points]
    timed = [(point.time, LatLon(point.latitude, point.longitude)) for point in points if point.time]
    fixes = [(t.replace(tzinfo=t.tzinfo or UTC).timestamp(), p) for t, p in timed if _on_earth(p)]
    track = make_track([t for t, _ in fixes], [p for _, p in fixes])
    if len(track) >= 2:
        return track
    if not points:
        raise TrackError("the file has no track", hint="routes and waypoints have no times: export the track")
    hint = "export the track with times" if not timed else None
    raise TrackError(
        f"of {len(points)} points of the track, {len(track)} have a time of their own", hint=hint
    )


def _on_earth(p: LatLon) -> bool:
    return abs(p.lat) <= 90.0 and abs(p.lon) <= 180.0


def _text(data: bytes) -> str:
    """Decode by byte order mark or declaration: what is looked for in the text is what the reader reads."""
    declared = _ENCODING.match(data)
    codec = next((codec for bom, codec in _BOMS if data.startswith(bom)), None)
    if codec is None:
        codec = declared[1].decode().lower() if declared else "utf-8"
        if codec not in _CODECS:
            raise TrackError(f"the file is coded in {codec}", hint="save it as UTF-8")
    try:
        return data.decode(codec)
    except UnicodeDecodeError as error:
        raise TrackError(f"the file is no text in {codec}", hint="save it as UTF-8") from error


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0][:200] if str(error) else type(error).__name__
