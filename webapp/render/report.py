"""The report of an evaluation, one self-contained HTML file, and the folder with its tables and poses."""

from __future__ import annotations

import base64
import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from PIL import Image

from webapp.core.evaluation.metrics import GRADES, WITHIN_PX, Row, outcomes
from webapp.core.hypotheses.places import KIND_WORDS
from webapp.errors import StorageError
from webapp.files.atomic import write_text
from webapp.files.contents import local
from webapp.files.exchange import tum
from webapp.files.maps.folder import boxes_in_file
from webapp.files.photos.photo import read_blurred, read_upright
from webapp.render.answer_pictures import draw_matches
from webapp.render.charts import error_chart, reliability_chart
from webapp.render.map_picture import draw_map
from webapp.resources import resource_folder
from webapp.settings import PhotoLimits
from webapp.tasks.evaluation.evaluate import to_json, trajectories
from webapp.tasks.evaluation.types import Evaluation

UNKNOWN = "–"


@dataclass(frozen=True, slots=True)
class QueryPictures:
    row: Row
    map_jpeg: bytes
    match_jpeg: bytes | None  # None if no match supports the hypothesis


@dataclass(frozen=True, slots=True)
class Figure:
    name: str
    words: str
    value: str
    interval: str


def render_report(evaluation: Evaluation, *, worst: Sequence[QueryPictures]) -> str:
    subject, summary = evaluation.subject, evaluation.summary
    environment = Environment(
        loader=FileSystemLoader(resource_folder("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(number=number, percent=percent, distance=distance, data_uri=data_uri)
    return environment.get_template("localize/report.html").render(
        evaluation=evaluation,
        subject=subject,
        summary=summary,
        kind=KIND_WORDS[subject.map_kind],
        title=subject.map_folder.resolve().name,
        figures={figure.name: figure for figure in figures(evaluation)},
        grades=[(word, limit * subject.place_radius_px) for word, limit in GRADES],
        rows=evaluation.rows,
        metres=subject.map.georeference is not None,
        error_chart=error_chart(outcomes(evaluation.results).errors, place_radius_px=subject.place_radius_px),
        reliability_chart=reliability_chart(summary.reliability),
        worst=worst,
    )


def figures(evaluation: Evaluation) -> list[Figure]:
    """Return every figure with its name in JSON, its words, and its formatted value and 95 % interval."""
    subject, s = evaluation.subject, evaluation.summary
    shares = {
        **{f"within_{r}px": (f"within {r} px", s.within[r]) for r in WITHIN_PX},
        "top5_within_50px": ("one of the first five within 50 px", s.top5_within_50px),
        "answered_at_99_precision": ("answered when 99 % must be right", s.answered_at_99_precision),
        "radius_coverage": ("right answers within their 68 % radius", s.radius_coverage),
    }
    plain = {
        "ece": ("calibration error", number(s.ece, 3)),
        "seconds_per_query_p50": ("time per query, median", _unit(number(s.seconds_per_query_p50, 3), "s")),
        "seconds_per_query_p95": ("time per query, 95 %", _unit(number(s.seconds_per_query_p95, 3), "s")),
        "extract_seconds_p50": ("of which keypoints", _unit(number(s.extract_seconds_p50, 3), "s")),
        "match_seconds_p50": ("of which matching and geometry", _unit(number(s.match_seconds_p50, 3), "s")),
        "build_seconds": ("time to build the index", _unit(number(subject.build_seconds, 1), "s")),
        "calibration_seconds": ("time to calibrate", _unit(number(subject.calibration_seconds, 1), "s")),
        "index_bytes": ("size of the index", _unit(number(subject.index_bytes / 1e6, 1), "MB")),
        "peak_rss_mb": ("largest memory", _unit(number(evaluation.peak_rss_mb, 0), "MiB")),
        "queries": ("queries", str(s.queries)),
        "failed": ("photos that could not be used", str(s.failed)),
        "abstained": ("answered “not on this map”", str(s.abstained)),
        "second_looks": ("with a second look", str(s.second_looks)),
    }
    lines = [
        Figure(
            "median_px", "median error", _unit(number(s.median_px, 1), "px"), _range(evaluation, "median_px")
        ),
        Figure("mean_px", "mean error", _unit(number(s.mean_px, 1), "px"), _range(evaluation, "mean_px")),
    ]
    lines += [Figure(k, w, percent(v), _range(evaluation, k, share=True)) for k, (w, v) in shares.items()]
    lines += [Figure(k, w, v, _range(evaluation, k, digits=3)) for k, (w, v) in plain.items()]
    return lines


def number(value: float | None, digits: int = 1) -> str:
    """Format a number with a fixed number of decimals; a dash if unknown."""
    return UNKNOWN if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def percent(share: float | None) -> str:
    """Format a share as a percentage; a dash if unknown."""
    return UNKNOWN if share is None else f"{100 * share:.1f} %"


def distance(value: float | None) -> str:
    """Format a distance of descriptors, whose magnitude depends on their kind, with about four digits."""
    size = abs(value or 0.0)
    return number(value, 0 if size >= 1000 else 1 if size >= 10 else 3)


def data_uri(jpeg: bytes) -> str:
    """Encode a JPEG as a data URI, so that the page needs no other file."""
    return "data:image/jpeg;base64," + base64.b64encode(jpeg).decode("ascii")


def _unit(text: str, unit: str) -> str:
    return text if text == UNKNOWN else f"{text} {unit}"


def _range(evaluation: Evaluation, name: str, *, share: bool = False, digits: int = 1) -> str:
    interval = evaluation.summary.intervals.get(name)
    if interval is None:
        return ""
    low, high = (percent(v) if share else number(v, digits) for v in interval)
    return f"{low.removesuffix(' %')} to {high}"


COLUMNS = (
    "path", "x", "y", "keypoints", "matches", "matches_pruned", "distance_min", "distance_max",
    "distance_mean", "distance_total", "seconds", "grade_first", "grade_others", "first_px", "worst_px",
    "first_m", "worst_m", "first_x", "first_y", "probability", "radius_px", "off_map_probability", "error",
)  # fmt: skip

WORST = 8
"""Queries that the report shows with pictures."""

JPEG_QUALITY = 80


def write_evaluation(evaluation: Evaluation, folder: Path, *, limits: PhotoLimits) -> None:
    """Write `report.html`, `results.csv`, `results.json`, `estimate.tum` and `truth.tum`.

    Args:
        folder: Created if missing; files of these names are replaced.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"the folder cannot be created: {error.strerror}", where=str(folder)) from error
    shown = pictured(evaluation, worst_rows(evaluation.rows, WORST), limits=limits)
    write_text(folder / "report.html", render_report(evaluation, worst=shown))
    write_text(folder / "results.csv", results_csv(evaluation.rows))
    write_text(folder / "results.json", json.dumps(to_json(evaluation), indent=1, allow_nan=False) + "\n")
    poses = trajectories(evaluation.results, evaluation.subject.map)
    for name, trajectory in (("estimate", poses.estimate), ("truth", poses.truth)):
        tum.write(
            folder / f"{name}.tum", trajectory, remarks=[poses.frame, "the timestamp counts the queries"]
        )


def worst_rows(rows: list[Row], count: int) -> list[Row]:
    """Choose the queries that have a hypothesis and the largest error, the worst first."""
    known = [(row.first_px, row) for row in rows if row.first_px is not None]
    return [row for _, row in sorted(known, key=lambda pair: -pair[0])[:count]]


def pictured(evaluation: Evaluation, rows: list[Row], *, limits: PhotoLimits) -> list[QueryPictures]:
    """Draw the map picture and the match picture of each row that has a hypothesis."""
    subject = evaluation.subject
    photos = {e.id: e for e in subject.map.experiences}
    satellite = read_upright(local(subject.map_folder / subject.map.satellite.path), limits=limits)
    shown = []
    for row in rows:
        answer = row.result.answer
        if answer is None:
            continue
        match = None
        for evidence in answer.evidence[:1]:
            query, photo = evaluation.query_folder / row.result.path, photos[evidence.experience]
            in_query = boxes_in_file(subject.map_folder, subject.map, file=query)
            match = draw_matches(
                read_blurred(query, in_query, limits=limits),
                read_blurred(local(subject.map_folder / photo.photo), photo.blurred, limits=limits),
                evidence=evidence,
                query_name=row.result.path,
                photo_name=photo.photo,
            )
        where = draw_map(satellite, subject.map, answer=answer, truth=row.result.truth)
        shown.append(QueryPictures(row, _jpeg(where), None if match is None else _jpeg(match)))
    return shown


def _jpeg(image: Image.Image) -> bytes:
    data = io.BytesIO()
    image.save(data, "JPEG", quality=JPEG_QUALITY, optimize=True)
    return data.getvalue()


def results_csv(rows: Iterable[Row]) -> str:
    """Write the table, columns separated by semicolons; unknown values are empty."""
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
