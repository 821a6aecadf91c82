"""Writes EXIF: whole blocks, positions and headings into copies of photos, and new photos with their tags.

For other programs, it writes XMP sidecars and a table for exiftool.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import piexif
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon
from webapp.errors import PhotoError
from webapp.files.atomic import storage_error, write_bytes
from webapp.files.decode import DAMAGED, open_image
from webapp.files.photos.exif import orientation, parse_block, read_exif
from webapp.settings import PhotoLimits

_QUALITY = 92

_XMP = """http://ns.adobe.com/xap/1.0/\0<x:xmpmeta xmlns:x="adobe:ns:meta/">
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/panorama/"
 GPano:ProjectionType="equirectangular" GPano:UsePanoramaViewer="True"{heading}
 GPano:FullPanoWidthPixels="{width}" GPano:FullPanoHeightPixels="{height}"
 GPano:CroppedAreaImageWidthPixels="{width}" GPano:CroppedAreaImageHeightPixels="{height}"
 GPano:CroppedAreaLeftPixels="0" GPano:CroppedAreaTopPixels="0"/>
</rdf:RDF></x:xmpmeta>"""

WRITABLE = ("JPEG", "MPO", "WEBP")
"""Formats, as Pillow names them, whose EXIF can be replaced without touching the pixels."""

_OF_A_FIX = {
    piexif.GPSIFD.GPSSatellites,
    piexif.GPSIFD.GPSStatus,
    piexif.GPSIFD.GPSMeasureMode,
    piexif.GPSIFD.GPSDOP,
    piexif.GPSIFD.GPSAreaInformation,
    piexif.GPSIFD.GPSDifferential,
    piexif.GPSIFD.GPSHPositioningError,
}
_MANUAL = b"ASCII\0\0\0MANUAL"
"""The processing method of EXIF 2.3 for positions set by a person."""


@dataclass(frozen=True, slots=True)
class CameraTags:
    """Tags to write; those that are None are left out."""

    taken_at: datetime | None  # The camera's clock, with its UTC offset if known
    focal_35mm: int | None  # Focal length in 35 mm film, mm, by the diagonal; a panorama has none
    position: LatLon | None = None
    heading_deg: float | None = None  # Viewing direction, degrees clockwise from true north
    accuracy_m: float | None = None  # 68 % radius of the position
    unique_id: str | None = None  # 32 hexadecimal digits


def exif_bytes(tags: CameraTags) -> bytes:
    """Write an EXIF block for a JPEG; positions to 0.1 mm, directions to 0.0001 degree."""
    gps = _gps_tags(tags.position, tags.heading_deg)
    if tags.accuracy_m is not None:
        gps[piexif.GPSIFD.GPSHPositioningError] = (round(tags.accuracy_m * 1000), 1000)
    camera: dict[int, object] = {}
    if tags.focal_35mm is not None:
        camera[piexif.ExifIFD.FocalLengthIn35mmFilm] = tags.focal_35mm
    if tags.unique_id is not None:
        camera[piexif.ExifIFD.ImageUniqueID] = tags.unique_id
    if tags.taken_at is not None:
        camera |= _time_tags(tags.taken_at)
    return bytes(piexif.dump({"Exif": camera, "GPS": gps}))


def _time_tags(moment: datetime) -> dict[int, object]:
    tags: dict[int, object] = {piexif.ExifIFD.DateTimeOriginal: moment.strftime("%Y:%m:%d %H:%M:%S")}
    if moment.microsecond:
        tags[piexif.ExifIFD.SubSecTimeOriginal] = f"{moment.microsecond:06}".rstrip("0")
    if moment.tzinfo is not None:
        tags[piexif.ExifIFD.OffsetTimeOriginal] = moment.isoformat()[-6:]
    return tags


def with_position(photo: bytes, tag: Geotag, *, limits: PhotoLimits) -> tuple[bytes, str | None]:
    """Write a position from a map into the EXIF of a photo, without re-encoding the pixels.

    If it is not by GPS, tags that describe a GPS fix (accuracy, satellites ...) are removed. Altitude, time
    and all other tags that piexif knows are kept.

    Args:
        photo: A JPEG or WebP file.
        tag: If it has no heading, that of the photo is kept.

    Returns:
        The file with the new block.
        A sentence about EXIF that could not be kept.

    Raises:
        PhotoError: It is not a photo, has another format, or its EXIF cannot be extended by the position.
    """
    with open_image(photo, limits=limits) as image:
        if image.format not in WRITABLE:
            raise PhotoError(
                f"positions cannot be written to {image.format} files",
                hint="convert it to JPEG or WebP first",
            )
        raw, turn = image.info.get("exif"), orientation(read_exif(image))[0]
    note = None
    tables = parse_block(raw) if isinstance(raw, bytes) else None
    if tables is None:
        note = "its damaged EXIF was replaced" if raw else None
        tables = {"0th": {piexif.ImageIFD.Orientation: turn}, "Exif": {}, "GPS": {}}
    tables["GPS"] = _with_fix(tables["GPS"], tag) | _gps_tags(tag.position, tag.heading_deg)
    result = io.BytesIO()
    try:
        piexif.insert(piexif.dump(tables), photo, result)
    except (*DAMAGED, OSError) as error:
        message = f"its EXIF cannot be extended: {error}"
        raise PhotoError(message, hint="save it again without EXIF") from error
    return result.getvalue(), note


def _with_fix(gps: dict[int, object], tag: Geotag) -> dict[int, object]:
    """Return the tags to keep: all if the position is the device's, else those that do not describe a fix."""
    if not tag.by_gps:
        kept = {key: value for key, value in gps.items() if key not in _OF_A_FIX}
        return kept | {piexif.GPSIFD.GPSProcessingMethod: _MANUAL}
    if tag.accuracy_m is None:
        return gps
    return gps | {piexif.GPSIFD.GPSHPositioningError: (round(tag.accuracy_m * 1000), 1000)}


def _gps_tags(position: LatLon | None, heading_deg: float | None) -> dict[int, object]:
    gps: dict[int, object] = {}
    if position is not None:
        lat, lon = position
        gps |= {
            piexif.GPSIFD.GPSVersionID: (2, 3, 0, 0),
            piexif.GPSIFD.GPSLatitudeRef: "N" if lat >= 0 else "S",
            piexif.GPSIFD.GPSLatitude: _degrees(lat),
            piexif.GPSIFD.GPSLongitudeRef: "E" if lon >= 0 else "W",
            piexif.GPSIFD.GPSLongitude: _degrees(lon),
            piexif.GPSIFD.GPSMapDatum: "WGS-84",
        }
    if heading_deg is not None:
        turn = round(heading_deg * 10_000) % 3_600_000
        gps |= {piexif.GPSIFD.GPSImgDirectionRef: "T", piexif.GPSIFD.GPSImgDirection: (turn, 10_000)}
    return gps


def _degrees(value: float) -> tuple[tuple[int, int], ...]:
    """Convert to degrees, minutes and seconds as rationals."""
    scale = 400_000  # of a second: 0.08 mm on the ground
    total = round(abs(value) * 3600 * scale)
    minutes, rest = divmod(total, 60 * scale)
    return (minutes // 60, 1), (minutes % 60, 1), (rest, scale)


def write_panorama(path: Path, pixels: NDArray[np.uint8], *, tags: CameraTags) -> None:
    """Write a panorama of the whole sphere as a JPEG, marked as such in its XMP. Raises StorageError."""
    height, width = pixels.shape[:2]
    heading = "" if tags.heading_deg is None else f' GPano:PoseHeadingDegrees="{tags.heading_deg:.4f}"'
    body = _XMP.format(width=width, height=height, heading=heading).encode()
    segment = b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
    _write(path, data[:2] + segment + data[2:], tags)


def write_view(path: Path, pixels: NDArray[np.uint8], *, tags: CameraTags) -> None:
    """Write a view as a JPEG. Raises StorageError."""
    _write(path, cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes(), tags)


def _write(path: Path, data: bytes, tags: CameraTags) -> None:
    out = io.BytesIO()
    piexif.insert(exif_bytes(tags), data, out)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, out.getvalue())
    except OSError as error:
        raise storage_error(error, where=str(path)) from error


_SIDECAR = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <rdf:Description rdf:about="" xmlns:exif="http://ns.adobe.com/exif/1.0/">
{fields}
  </rdf:Description>
 </rdf:RDF>
</x:xmpmeta>
<?xpacket end="w"?>
"""
_COLUMNS = (
    "SourceFile",
    "GPSLatitude",
    "GPSLatitudeRef",
    "GPSLongitude",
    "GPSLongitudeRef",
    "GPSImgDirection",
    "GPSImgDirectionRef",
    "GPSMapDatum",
    "GPSHPositioningError",
)


@dataclass(frozen=True, slots=True)
class Geotag:
    position: LatLon  # WGS 84
    heading_deg: float | None = None  # Clockwise from true north; None if unknown
    # Whether the position is that of the photo's GPS; otherwise a person or a track set it.
    by_gps: bool = False
    accuracy_m: float | None = None  # 68 % radius of a position by GPS


def format_xmp(tag: Geotag) -> bytes:
    """Write a sidecar: an XMP packet with the GPS properties of EXIF."""
    fields = {
        "GPSVersionID": "2.3.0.0",
        "GPSMapDatum": "WGS-84",
        "GPSLatitude": _degrees_text(tag.position.lat, "NS"),
        "GPSLongitude": _degrees_text(tag.position.lon, "EW"),
    }
    if tag.heading_deg is not None:
        fields["GPSImgDirection"] = f"{round(tag.heading_deg * 100) % 36_000}/100"
        fields["GPSImgDirectionRef"] = "T"
    if tag.accuracy_m is not None:
        fields["GPSHPositioningError"] = f"{round(tag.accuracy_m * 1000)}/1000"
    lines = "\n".join(f"   <exif:{name}>{value}</exif:{name}>" for name, value in fields.items())
    return _SIDECAR.format(fields=lines).encode()


def format_exiftool_csv(rows: Iterable[tuple[str, Geotag]]) -> Iterator[bytes]:
    """Write a table for `exiftool -csv=FILE -n`.

    Args:
        rows: File names and positions of the photos. Names that a spreadsheet would take for a formula are
            not escaped: exiftool compares them with those of the files.

    Yields:
        UTF-8, one piece per photo.
    """
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(_COLUMNS)
    for name, tag in rows:
        lines.writerow([name, *_cells(tag)])
        yield text.getvalue().encode("utf-8", "replace")
        text.seek(0)
        text.truncate()
    yield text.getvalue().encode()


def _cells(tag: Geotag) -> Iterator[str]:
    lat, lon = tag.position
    yield from (f"{lat:.9f}", "N" if lat >= 0 else "S", f"{lon:.9f}", "E" if lon >= 0 else "W")
    yield from ("", "") if tag.heading_deg is None else (f"{tag.heading_deg % 360:.2f}", "T")
    yield from ("WGS-84", "" if tag.accuracy_m is None else f"{tag.accuracy_m:.3f}")


def _degrees_text(value: float, letters: str) -> str:
    """Write degrees and minutes as in XMP, to a tenth of a millimetre."""
    total = round(abs(value) * 60 * 10**7)
    degrees, rest = divmod(total, 60 * 10**7)
    return f"{degrees},{rest / 10**7:.7f}{letters[0] if value >= 0 else letters[1]}"
