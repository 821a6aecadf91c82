"""Writes an evaluation into a folder: the report, the tables, the poses."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from PIL import Image

from webapp.core.evaluation.metrics import Row
from webapp.errors import StorageError
from webapp.files.atomic import write_text
from webapp.files.contents import local
from webapp.files.exchange import tum
from webapp.files.maps.folder import boxes_in_file
from webapp.files.photos.photo import read_blurred, read_upright
from webapp.render.answer_pictures import draw_matches
from webapp.render.map_picture import draw_map
from webapp.render.report import QueryPictures, render_report
from webapp.settings import PhotoLimits
from webapp.tasks.evaluation.evaluate import to_json
from webapp.tasks.evaluation.poses import trajectories
from webapp.tasks.evaluation.types import Evaluation

COLUMNS = (
    "path", "x", "y", "keypoints", "matches", "matches_pruned", "distance_min", "distance_max",
    "distance_mean", "distance_total", "seconds", "grade_first", "grade_others", "first_px", "worst_px",
    "first_m", "worst_m", "first_x", "first_y", "probability", "radius_px", "off_map_probability", "error",
)  # fmt: skip

WORST = 8
"""Queries that the report shows with pictures."""

JPEG_QUALITY = 80


def write(evaluation: Evaluation, folder: Path, *, limits: PhotoLimits, worst: int = WORST) -> None:
    """Write `report.html`, `results.csv`, `results.json`, `estimate.tum` and `truth.tum`.

    Args:
        folder: Created if missing; files of these names are replaced.
        limits: For the photos in the report.
        worst: How many queries the report shows with pictures.

    Raises:
        StorageError: The folder or a file in it cannot be written.
        PhotoError: A photo that was localized, or the map's image, can no longer be read.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"the folder cannot be created: {error.strerror}", where=str(folder)) from error
    shown = pictured(evaluation, worst_rows(evaluation.rows, worst), limits=limits)
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
    """Write the table, columns separated by semicolons; unknown values are empty.

    Returns:
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
