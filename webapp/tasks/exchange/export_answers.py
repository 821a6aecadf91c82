"""Downloads of the answers of a map: one line or point per query."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from webapp.files.exchange.answers import (
    AnswerRow,
    format_answers_csv,
    format_answers_geojson,
    format_answers_gpx,
)
from webapp.store import queries
from webapp.store.library import Library
from webapp.store.schema import MapRecord, QueryRecord
from webapp.tasks.exchange.export_source import Download, plain_name

AnswerFormat = Literal["csv", "gpx", "geojson"]


@dataclass(frozen=True, slots=True)
class AnswerRange:
    """Selection of answers."""

    # `first`, `last`: Ids, inclusive; None for no limit.
    first: int | None = None
    last: int | None = None
    account_id: int | None = None  # Account that asked; None for all


def export_answers(library: Library, map_id: int, *, form: AnswerFormat, which: AnswerRange) -> Download:
    """Write answers of a map, the oldest first.

    Raises:
        NotFound: The map does not exist.
    """
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        found = queries.answers(
            session, record, first=which.first, last=which.last, account_id=which.account_id
        )
        rows, title, name = [_row(query) for query in found], record.name, plain_name(record.slug)
    match form:
        case "csv":
            return Download(f"{name}-answers.csv", "text/csv; charset=utf-8", format_answers_csv(rows))
        case "gpx":
            data = format_answers_gpx(rows, title=title)
            return Download(f"{name}-answers.gpx", "application/gpx+xml", data)
        case _:
            data = format_answers_geojson(rows, title=title)
            return Download(f"{name}-answers.geojson", "application/geo+json", data)


def _row(query: QueryRecord) -> AnswerRow:
    first: dict[str, Any] = next(iter(query.answer["hypotheses"]), {})
    return AnswerRow(
        id=query.id,
        photo=query.name,
        probability=first.get("probability"),
        off_map_probability=query.answer.get("off_map_probability"),
        x_px=first.get("x_px"),
        y_px=first.get("y_px"),
        lat=first.get("lat"),
        lon=first.get("lon"),
        radius_m=first.get("radius_m"),
        heading_deg=first.get("heading_deg"),
        floor=first.get("floor_name"),
    )
