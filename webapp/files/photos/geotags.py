"""Positions of photos for other programs: XMP sidecars, and a table for exiftool."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from webapp.core.geo.types import LatLon

_XMP = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
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
    """The position of a photo."""

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
        "GPSLatitude": _degrees(tag.position.lat, "NS"),
        "GPSLongitude": _degrees(tag.position.lon, "EW"),
    }
    if tag.heading_deg is not None:
        fields["GPSImgDirection"] = f"{round(tag.heading_deg * 100) % 36_000}/100"
        fields["GPSImgDirectionRef"] = "T"
    if tag.accuracy_m is not None:
        fields["GPSHPositioningError"] = f"{round(tag.accuracy_m * 1000)}/1000"
    lines = "\n".join(f"   <exif:{name}>{value}</exif:{name}>" for name, value in fields.items())
    return _XMP.format(fields=lines).encode()


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


def _degrees(value: float, letters: str) -> str:
    """Write degrees and minutes as in XMP, to a tenth of a millimetre."""
    total = round(abs(value) * 60 * 10**7)
    degrees, rest = divmod(total, 60 * 10**7)
    return f"{degrees},{rest / 10**7:.7f}{letters[0] if value >= 0 else letters[1]}"
