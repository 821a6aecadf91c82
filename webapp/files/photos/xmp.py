"""The XMP of a photo or of its sidecar file: position, heading, and what drones of DJI write."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from PIL import Image

from webapp.core.geometry.tilt import LEVEL, Tilt
from webapp.errors import TrackError
from webapp.files.photos.exif import ABSENT, Gps, Heading, NoGps, read_gps, read_heading

MAX_BYTES = 2_000_000
"""Of a packet; those with a long history of edits have a few hundred kilobytes."""

_EXIF = "http://ns.adobe.com/exif/1.0/"
_DJI = "http://www.dji.com/drone-dji/1.0/"
_PANO = "http://ns.google.com/photos/1.0/panorama/"
_WIDE = 2.4
"""Aspect ratio from which on a photo may be a part of a panorama: no camera has such a sensor."""

_WHOLE, _TOLERANCE = 2.0, 0.01
_TILTS = {"PosePitchDegrees": 90, "PoseRollDegrees": 360}
"""Properties, and how large their numbers may be; some cameras count the roll from 0 to 360."""

_TILT_DIGITS = 2
_PHOTO = ["RDF", "Description"]
"""Elements around the properties of the photo itself; deeper ones may be of the place that it shows."""

_ANGLE = re.compile(
    r"([+-]?\d{1,3}(?:\.\d{1,20})?)(?:,(\d{1,2}(?:\.\d{1,20})?))?(?:,(\d{1,2}(?:\.\d{1,20})?))?\s*([NSEWnsew]?)"
)
"""`50,6.5N`, `50,6,30N` or, by some programs, `50.1`."""

_EXIF_TAGS = {
    "GPSAltitude": 6,
    "GPSDOP": 11,
    "GPSImgDirection": 17,
    "GPSHPositioningError": 31,
}
_EXIF_TEXTS = {"GPSStatus": 9, "GPSImgDirectionRef": 16, "GPSMapDatum": 18}


@dataclass(frozen=True, slots=True)
class Xmp:
    """The properties of a packet: texts by `{namespace}name`. Falsy if there are none."""

    properties: Mapping[str, str] = field(default_factory=dict)
    note: str | None = None  # A sentence if it is damaged

    def __bool__(self) -> bool:
        return bool(self.properties)

    def exif(self, name: str) -> str:
        """Return a property of EXIF; empty without it."""
        return self.properties.get(f"{{{_EXIF}}}{name}", "")

    def panorama(self, name: str) -> str:
        """Return a property of Photo Sphere; empty without it."""
        return self.properties.get(f"{{{_PANO}}}{name}", "")

    def dji(self, name: str) -> float:
        """Return a number that a drone of DJI has written; NaN without it."""
        return _number(self.properties.get(f"{{{_DJI}}}{name}", ""))


def read_xmp(image: Image.Image) -> Xmp:
    """Read the XMP of an opened photo of any format; damaged XMP is left out and noted."""
    packet = image.info.get("xmp") or image.info.get("XML:com.adobe.xmp")
    if isinstance(packet, tuple):  # of TIFF, by its type
        packet = packet[0] if packet else None
    if isinstance(packet, str):
        packet = packet.encode("utf-8", "replace")
    return parse_xmp(packet) if isinstance(packet, bytes) else Xmp()


def parse_xmp(packet: bytes) -> Xmp:
    """Parse a packet, or the content of a sidecar."""
    text = packet.strip(b"\0 \t\r\n").removeprefix(b"\xef\xbb\xbf")
    if not text:
        return Xmp()
    if len(text) > MAX_BYTES:
        return Xmp(note=f"its XMP has more than {MAX_BYTES // 10**6} MB and was left out")
    from webapp.files.exchange.xml import local_name, walk  # imported lazily: most photos have no XMP

    found: dict[str, str] = {}
    path: list[str] = []
    try:
        for event, element in walk(io.BytesIO(text), whole=()):
            if event == "start":
                path.append(local_name(element))
                if path[-2:] == _PHOTO:
                    found.update((str(name), str(value).strip()) for name, value in element.attrib.items())
                continue
            path.pop()
            if path[-2:] == _PHOTO and element.text and element.text.strip():
                found.setdefault(str(element.tag), element.text.strip())
    except TrackError:
        return Xmp(note="its XMP is damaged and was left out")
    return Xmp(found)


@dataclass(frozen=True, slots=True)
class PhotoPlace:
    """Where a photo was taken and where it looks, as far as its file says."""

    gps: Gps | NoGps
    heading: Heading | None = None
    pitch_deg: float | None = None  # Of the camera above the horizon; below it negative


def locate(tags: Mapping[int, object], xmp: Xmp) -> PhotoPlace:
    """Find position and heading: in the GPS IFD of EXIF, else in EXIF within XMP, else by a drone."""
    gps, heading = read_gps(tags), read_heading(tags)
    if not xmp:
        return PhotoPlace(gps, heading)
    in_xmp, of_drone = _exif_tags(xmp), _drone_tags(xmp)
    for source, other in (("XMP", in_xmp), ("DJI XMP", of_drone)):
        if isinstance(gps, NoGps):
            found = read_gps(other)
            if isinstance(found, Gps) and not gps.refuses(found):
                gps = replace(found, source=source)
            elif gps == ABSENT:
                gps = found
        heading = heading or read_heading(other)
    pitch = xmp.dji("GimbalPitchDegree")
    return PhotoPlace(_by_drone(gps, xmp), heading, None if math.isnan(pitch) else pitch)


def _exif_tags(xmp: Xmp) -> dict[int, object]:
    """Return the GPS properties of XMP as tags of the GPS IFD."""
    tags: dict[int, object] = {}
    for name, tag, letters in (("GPSLatitude", 2, "NS"), ("GPSLongitude", 4, "EW")):
        found = _ANGLE.fullmatch(xmp.exif(name).strip())
        if found is None:
            if xmp.exif(name):
                tags[tag] = ()  # which is reported as empty
            continue
        degrees, minutes, seconds = (float(part or 0.0) for part in found.group(1, 2, 3))
        tags[tag] = (abs(degrees), minutes, seconds)
        tags[tag - 1] = found[4] or letters[int(found[1].startswith("-"))]
    for name, tag in _EXIF_TAGS.items():
        value = _rational(xmp.exif(name))
        if not math.isnan(value):
            tags[tag] = value
    tags.update({tag: xmp.exif(name) for name, tag in _EXIF_TEXTS.items() if xmp.exif(name)})
    if xmp.exif("GPSAltitudeRef").isdecimal():
        tags[5] = int(xmp.exif("GPSAltitudeRef")[:2])
    return tags


def _drone_tags(xmp: Xmp) -> dict[int, object]:
    """Return what DJI writes as tags of the GPS IFD; its yaw counts from true north."""
    lat, lon = xmp.dji("GpsLatitude"), xmp.dji("GpsLongitude")
    if math.isnan(lon):
        lon = xmp.dji("GpsLongtitude")  # sic, in older firmware
    tags: dict[int, object] = {}
    if not math.isnan(lat) and not math.isnan(lon):
        tags |= {1: "S" if lat < 0 else "N", 2: abs(lat), 3: "W" if lon < 0 else "E", 4: abs(lon)}
    height, yaw = xmp.dji("AbsoluteAltitude"), xmp.dji("GimbalYawDegree")
    if not math.isnan(height):
        tags[6] = height
    if not math.isnan(yaw):
        tags |= {16: "T", 17: yaw % 360.0}
    return tags


def _by_drone(gps: Gps | NoGps, xmp: Xmp) -> Gps | NoGps:
    """Complete a position by its accuracy with RTK and its altitude above the start."""
    if isinstance(gps, NoGps):
        return gps
    relative = xmp.dji("RelativeAltitude")
    if not math.isnan(relative):
        gps = replace(gps, relative_altitude_m=relative)
    std = math.hypot(xmp.dji("RtkStdLat"), xmp.dji("RtkStdLon"))
    return replace(gps, accuracy_m=std) if std > 0.0 and gps.source != "XMP" else gps


def _number(text: str) -> float:
    """Parse a finite number; NaN for anything else."""
    try:
        value = float(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def _rational(text: str) -> float:
    above, _, below = text.partition("/")
    divisor = _number(below) if below else 1.0
    return _number(above) / divisor if divisor else math.nan


def panorama_notes(xmp: Xmp, *, width: int, height: int, has_fov: bool) -> tuple[str, ...]:
    """Return sentences about a photo that is, or may be, a panorama but is not taken for one as it is.

    Args:
        has_fov: Whether its EXIF says its field of view, as for photos of one shot.
    """
    ratio = max(width, height) / min(width, height)
    if not xmp.panorama("ProjectionType"):
        if ratio >= _WIDE:
            return ("it is as wide as a part of a panorama, and is taken as a plain photo",)
        if width > height and abs(ratio - _WHOLE) <= _TOLERANCE * _WHOLE and not has_fov:
            return ("it is twice as wide as high like a panorama, but its metadata do not mark it as one",)
        return ()
    full, shown = xmp.panorama("FullPanoWidthPixels"), xmp.panorama("CroppedAreaImageWidthPixels")
    if (full and shown and full != shown) or abs(width / height - _WHOLE) > _TOLERANCE * _WHOLE:
        return ("it is a part of a panorama, and is taken as a plain photo",)
    tilt, problem = read_tilt({name: xmp.panorama(name) for name in _TILTS})
    if problem:
        return (problem,)
    return () if tilt.is_level else ("its panorama is levelled by the pitch and roll in its metadata",)


def read_tilt(tags: Mapping[str, str]) -> tuple[Tilt, str]:
    """Read the tilt of a panorama from its properties of Photo Sphere, by name.

    Returns:
        tilt: Level if one of the angles is missing or not valid.
        problem: A sentence about an angle that is not valid; else empty.
    """
    angles = []
    for name, most in _TILTS.items():
        text = tags.get(name, "").strip()
        value = _number(text) if text else 0.0
        if not abs(value) <= most:
            return (
                LEVEL,
                f"its {name} is not a number of degrees from -{most} to {most}: it is taken as level",
            )
        angles.append(round(math.remainder(value, 360.0), _TILT_DIGITS) + 0.0)
    return Tilt(*angles), ""
