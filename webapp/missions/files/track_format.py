"""Detects the format of a track file from its content."""

from __future__ import annotations

import codecs
import io
import itertools
import zipfile
from pathlib import Path
from typing import Literal

from webapp.errors import TrackError
from webapp.files.exchange.xml import local_name, walk
from webapp.files.text_file import numbered_lines
from webapp.missions.files.fit import is_fit
from webapp.missions.files.igc import is_igc
from webapp.missions.files.kml_reader import opened_kml
from webapp.missions.files.nmea import is_sentence
from webapp.missions.files.trajectory_text import layout_of

Kind = Literal[
    "ros1", "ros2-sqlite", "ros2-mcap", "ros2-folder", "gpx", "tcx", "kml", "kmz", "geojson", "fit", "igc",
    "nmea", "tum", "kitti", "csv",
]  # fmt: skip

TITLES: dict[Kind, str] = {
    "ros1": "ROS 1 bag",
    "ros2-sqlite": "ROS 2 bag (SQLite)",
    "ros2-mcap": "ROS 2 bag (MCAP)",
    "ros2-folder": "ROS 2 bag",
    "gpx": "GPX",
    "tcx": "TCX",
    "kml": "KML",
    "kmz": "KMZ",
    "geojson": "GeoJSON",
    "fit": "FIT",
    "igc": "IGC",
    "nmea": "NMEA 0183",
    "tum": "TUM trajectory",
    "kitti": "KITTI trajectory",
    "csv": "table",
}
"""Names of the kinds, for display."""

_HEAD = 4096
_XML_HEAD = 1_000_000
_LINES = 50
_KML_ROOTS = {"kml", "Document", "Folder", "Placemark", "NetworkLink"}
_HINT = "known are ROS bags, MCAP, GPX, TCX, KML, KMZ, GeoJSON, FIT, IGC, NMEA, TUM, KITTI and CSV"
_WIDE = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def kind_of(path: Path, *, table: bool = False) -> Kind:
    """Detect the kind of a file, or of the folder of a ROS 2 bag.

    Args:
        table: Treat any text file as a table.

    Raises:
        TrackError: The file is not a track, cannot be read, or is XML that declares a document type.
    """
    try:
        if path.is_dir():
            if (path / "metadata.yaml").is_file():
                return "ros2-folder"
            raise TrackError("the folder is not a ROS 2 bag", hint="it needs a metadata.yaml")
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        message = f"the file cannot be read: {error.strerror or error}"
        raise TrackError(message, hint="check its path") from error
    if not head:
        raise TrackError("the file is empty")
    kind = _binary(path, head)
    if kind is not None:
        return kind
    if head.lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n\0").startswith(b"<"):
        return _xml(path)
    if head.startswith(_WIDE):
        raise TrackError("the file is UTF-16 text", hint="save it as UTF-8")
    if b"\0" in head:
        raise TrackError("this is not a file with a track", hint=_HINT)
    return "csv" if table else _text(path)


def _binary(path: Path, head: bytes) -> Kind | None:
    if head.startswith(b"#ROSBAG V"):
        return "ros1"
    if head.startswith(b"\x89MCAP0\r\n"):
        return "ros2-mcap"
    if head.startswith(b"SQLite format 3\0"):
        return "ros2-sqlite"
    if is_fit(head):
        return "fit"
    if not head.startswith(b"PK\x03\x04"):
        return None
    if zipfile.is_zipfile(path):
        with opened_kml(path):
            return "kmz"
    raise TrackError("the zip is damaged or cut off")


def _xml(path: Path) -> Kind:
    with path.open("rb") as file:
        beginning = io.BytesIO(file.read(_XML_HEAD))  # no endless comment, and no attribute of gigabytes
    _, root = next(walk(beginning, whole=()))
    name = local_name(root)
    if name == "gpx":
        return "gpx"
    if name == "TrainingCenterDatabase":
        return "tcx"
    if name in _KML_ROOTS:
        return "kml"
    raise TrackError(f"the XML is neither GPX, TCX nor KML: it begins with <{name[:40]}>", hint=_HINT)


def _text(path: Path) -> Kind:
    with path.open("rb") as file:
        if file.read(_HEAD).lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"{", b"[")):
            return "geojson"
        file.seek(0)
        lines = [line for _, line in itertools.islice(numbered_lines(file), _LINES)]
    if is_igc(lines):
        return "igc"
    if any(is_sentence(line) for line in lines):
        return "nmea"
    content = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if content and (layout := layout_of(content[0])):
        return layout
    if content and any(mark in content[0] for mark in ",;\t|"):
        return "csv"
    raise TrackError("the text has no known format", hint=_HINT)
