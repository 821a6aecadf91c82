"""The table of an experiment as CSV, one line a query."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import asdict

from webapp.core.evaluation.rows import Row

COLUMNS = (
    "path", "x", "y", "keypoints", "matches", "matches_pruned", "distance_min", "distance_max",
    "distance_mean", "distance_total", "seconds", "grade_first", "grade_others", "first_px", "worst_px",
    "first_m", "worst_m", "first_x", "first_y", "probability", "radius_px", "off_map_probability", "error",
)  # fmt: skip


def results_csv(rows: Iterable[Row]) -> str:
    """Write the table, columns separated by semicolons; what is unknown is empty.

    Returns
    -------
    str
        With a header line.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, delimiter=";", lineterminator="\n")
    writer.writeheader()
    writer.writerows(_record(row) for row in rows)
    return text.getvalue()


def _record(row: Row) -> dict[str, object]:
    result, answer = row.result, row.result.answer
    record: dict[str, object] = {
        "path": result.path,
        "x": result.truth.x,
        "y": result.truth.y,
        "seconds": row.seconds,
        "grade_first": row.grade_first,
        "grade_others": row.grade_others,
        "first_px": row.first_px,
        "worst_px": row.worst_px,
        "first_m": row.first_m,
        "worst_m": row.worst_m,
        "error": result.error,
    }
    if answer is not None:
        record |= asdict(answer.statistics) | {"off_map_probability": answer.off_map_probability}
        for first in answer.hypotheses[:1]:
            record |= {"first_x": first.position.x, "first_y": first.position.y}
            record |= {"probability": first.probability, "radius_px": first.radius_px}
    return record
