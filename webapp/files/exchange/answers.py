"""Answers for many photos (where each was most probably taken) as CSV, GPX waypoints or GeoJSON."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields

from webapp.core.geo.types import LatLon
from webapp.files.exchange.geojson import point_feature, write_collection
from webapp.files.exchange.xml import DECLARATION, element
from webapp.files.text_file import plain_cell


@dataclass(frozen=True, slots=True)
class AnswerRow:
    """The first hypothesis for a photo; fields are None where it has none, or where they are unknown."""

    id: int  # Id of the answer
    photo: str  # Name of the photo's file
    probability: float | None
    off_map_probability: float | None  # Probability that the photo was not taken on the map
    x_px: float | None
    y_px: float | None
    lat: float | None
    lon: float | None
    radius_m: float | None
    heading_deg: float | None
    floor: str | None = None  # Name of the floor; a table has this column only if some row has a floor

    @property
    def latlon(self) -> LatLon | None:
        return None if self.lat is None or self.lon is None else LatLon(self.lat, self.lon)


def format_answers_csv(rows: Sequence[AnswerRow]) -> Iterator[bytes]:
    """Write a header line and a line for each photo; unknown values are empty.

    Yields:
        UTF-8, as in RFC 4180; text is escaped so that spreadsheets see no formulas.
    """
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\r\n")
    left_out: set[str] = set() if any(row.floor for row in rows) else {"floor"}
    columns = [field.name for field in fields(AnswerRow) if field.name not in left_out]
    lines.writerow(columns)
    lines.writerows([plain_cell(getattr(row, column)) for column in columns] for row in rows)
    yield text.getvalue().encode("utf-8", "replace")


def format_answers_geojson(rows: Sequence[AnswerRow], *, title: str) -> Iterator[bytes]:
    """Write a point for each photo; its geometry is null where the position is unknown.

    Yields:
        UTF-8.
    """
    return write_collection(
        title, ([point_feature(row.id, row.latlon, properties=_properties(row))] for row in rows)
    )


def format_answers_gpx(rows: Sequence[AnswerRow], *, title: str) -> Iterator[bytes]:
    """Write a waypoint, named after the photo, for each photo whose position is known.

    Yields:
        UTF-8.
    """
    yield DECLARATION.encode()
    yield b'<gpx version="1.1" creator="Experience Map" xmlns="http://www.topografix.com/GPX/1/1">\n'
    yield f"<metadata>{element('name', title)}</metadata>\n".encode("utf-8", "replace")
    for row in rows:
        if row.lat is not None and row.lon is not None:
            says = f"{row.probability:.0%}" if row.probability is not None else ""
            inner = element("name", row.photo) + element("desc", says)
            yield f'<wpt lat="{row.lat:.9f}" lon="{row.lon:.9f}">{inner}</wpt>\n'.encode("utf-8", "replace")
    yield b"</gpx>\n"


def _properties(row: AnswerRow) -> dict[str, object]:
    left_out = {"id", "lat", "lon"} | (set() if row.floor else {"floor"})
    return {name: value for name, value in asdict(row).items() if name not in left_out}
