"""Measures answers to altered queries: bars of screenshots, crops, zoom, wrong EXIF, dim, blurred, rotated.

An answer is honest if its first place is within the place radius, if its 95 % circle (twice the stated 68 %
radius) contains the truth, or if its probability is below one half. The share of honest answers should be
above 0.95 for each alteration. Altered photos have no EXIF, but for those with a wrong focal length in it:
--fov gives the field of view of the queries as they are, from which that of crops follows and by which focal
lengths are wrong; without it, it is guessed for all.

    python -m benchmarks.altered_queries MAP.cfg QUERIES.csv [--limit N] [--index FOLDER] [--fov DEGREES]
        [--method NAME] [--only WORD] [--json OUT]
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from benchmarks.figures import percentile, plain, ratio, table
from benchmarks.worse_photos import NOISE, Photo, dimmed, rotated
from webapp.configuration import load_settings
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.verdict import verdict_of
from webapp.core.retrieval.fields_of_view import cropped_fov_deg, guessed_fov_deg
from webapp.files.localize import queries_csv
from webapp.progress import Progress
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions

_SURE = 0.5
_QUALITY = 95
_EXIF, _FOCAL_35MM = 0x8769, 0xA405
"""Tags of EXIF."""
_DIAGONAL_35MM = math.hypot(36.0, 24.0)
"""Diagonal of 35 mm film, mm."""


@dataclass(frozen=True, slots=True)
class Alteration:
    """A change of a photo, the share of its width that remains in view, and what its EXIF states."""

    change: Callable[[Photo], Photo]
    seen: float = 1.0
    focal: float | None = None  # The focal length in EXIF over the true one; None: no EXIF


def with_bars(photo: Photo) -> Photo:
    """Put the photo between bars as on a phone held upright, with a line of status above."""
    height, width = photo.shape[:2]
    more = max(0, int(width * 19.5 / 9.0) - height)
    shot = np.pad(photo, ((more // 2, more - more // 2), (0, 0), (0, 0)), constant_values=12)
    size = max(width / 900.0, 0.2)
    if more:
        cv2.putText(shot, "12:34", (width // 20, more // 8 + 8), cv2.FONT_HERSHEY_SIMPLEX, size, (240,) * 3)
    return np.asarray(shot, np.uint8)


def write_photo(path: Path, photo: Photo, *, focal_px: float | None) -> None:
    """Write a photo without loss that matters, with a focal length in EXIF if one is given."""
    exif = Image.Exif()
    if focal_px is not None:
        height, width = photo.shape[:2]
        exif.get_ifd(_EXIF)[_FOCAL_35MM] = round(focal_px * _DIAGONAL_35MM / math.hypot(width, height))
    Image.fromarray(photo[:, :, ::-1]).save(path, quality=_QUALITY, subsampling=0, exif=exif)


def cropped(photo: Photo, share: float) -> Photo:
    """Keep the middle of the photo."""
    height, width = photo.shape[:2]
    y, x = round(height * (1.0 - share) / 2.0), round(width * (1.0 - share) / 2.0)
    return np.ascontiguousarray(photo[y : height - y, x : width - x])


def zoomed(photo: Photo, factor: float) -> Photo:
    """Enlarge the middle of the photo to its full size."""
    height, width = photo.shape[:2]
    middle = cropped(photo, 1.0 / factor)
    return np.asarray(cv2.resize(middle, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


ALTERATIONS: Mapping[str, Alteration] = {
    "as they are": Alteration(lambda photo: photo),
    "bars of a screenshot": Alteration(with_bars),
    "cropped to 70 %": Alteration(lambda photo: cropped(photo, 0.7), seen=0.7),
    "cropped to 50 %": Alteration(lambda photo: cropped(photo, 0.5), seen=0.5),
    "digital zoom by 2": Alteration(lambda photo: zoomed(photo, 2.0), seen=0.5),
    "EXIF of half the focal length": Alteration(lambda photo: photo, focal=0.5),
    "EXIF of twice the focal length": Alteration(lambda photo: photo, focal=2.0),
    "a twentieth of the light": Alteration(lambda photo: dimmed(photo, 0.05, NOISE)),
    "blurred by 2.5 px": Alteration(lambda photo: np.asarray(cv2.GaussianBlur(photo, (0, 0), 2.5), np.uint8)),
    "rotated by 20 degrees": Alteration(lambda photo: rotated(photo, 20.0)),
    "black": Alteration(lambda photo: dimmed(photo, 0.0, 1.0)),
}

COLUMNS = {
    "right": plain("right"),
    "median px": plain("median_px", 1),
    "p90 px": plain("p90_px", 1),
    "sure and wrong": plain("sure_and_wrong"),
    "honest": plain("honest"),
    "nothing to see": plain("nothing_to_see"),
}


def main() -> None:
    """Measure each alteration, without and, if it is given, with the right field of view."""
    arguments = _arguments()
    options = OpenOptions(method=arguments.method, index=arguments.index)
    pipeline = open_pipeline(arguments.map, options, settings=load_settings(), progress=Progress())
    queries = queries_csv.select(queries_csv.read(arguments.queries), arguments.limit or None)
    rows = []
    for name, alteration in ALTERATIONS.items():
        if arguments.only not in name:
            continue
        given: list[float | None] = [None]
        if arguments.fov is not None and alteration.focal is None:
            given.append(cropped_fov_deg(arguments.fov, alteration.seen))
        for fov_deg in given:
            found = _measured(pipeline, queries, alteration, fov_deg=fov_deg, true_fov_deg=arguments.fov)
            rows.append({"name": name + ("" if fov_deg is None else ", field of view given"), **found})
    print(table(f"altered queries, place radius {pipeline.place_radius_px:.0f} px", COLUMNS, rows))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2), "utf-8")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    add = parser.add_argument
    add("map", type=Path)
    add("queries", type=Path)
    add("--limit", type=int, default=0, help="queries, evenly spread; 0 for all")
    add("--index", type=Path, help="folder for the indexes, to be used again")
    add("--fov", type=float, help="horizontal field of view of the queries, degrees")
    add("--method", default="auto")
    add("--only", default="", help="a part of the names of the alterations to measure")
    add("--json", type=Path, help="write all figures there")
    return parser.parse_args()


def _focal_px(photo: Photo, fov_deg: float | None) -> float:
    """Return the focal length of a photo with a field of view; guessed without one."""
    height, width = photo.shape[:2]
    fov_deg = guessed_fov_deg(width, height) if fov_deg is None else fov_deg
    return float(width / 2.0 / math.tan(math.radians(fov_deg) / 2.0))


def _measured(
    pipeline: LocalizationPipeline,
    queries: Sequence[Any],
    alteration: Alteration,
    *,
    fov_deg: float | None,
    true_fov_deg: float | None,
) -> dict[str, Any]:
    errors, sure_and_wrong, honest, blank = [], 0, 0, 0
    with tempfile.TemporaryDirectory() as scratch:
        for query in queries:
            photo = cv2.imread(str(query.path), cv2.IMREAD_COLOR)
            if photo is None:
                raise SystemExit(f"{query.path} cannot be read")
            path = Path(scratch) / "query.jpg"
            altered = alteration.change(np.asarray(photo, np.uint8))
            focal = alteration.focal and alteration.focal * _focal_px(altered, true_fov_deg)
            write_photo(path, altered, focal_px=focal)
            with_fov = LocalizationPipeline(pipeline.method, pipeline.looks, pipeline.both, fov_deg)
            answer = with_fov.localize(path, top=5)
            error = math.inf
            if answer.hypotheses:
                error = math.dist(answer.hypotheses[0].position, query.truth)
            errors.append(error)
            right, is_sure = error <= pipeline.place_radius_px, _is_sure(answer)
            sure_and_wrong += is_sure and not right
            honest += right or not is_sure or error <= 2.0 * (answer.hypotheses[0].radius_px or 0.0)
            blank += verdict_of(answer) == "nothing_to_see"
    count = len(queries)
    finite = [e for e in errors if math.isfinite(e)]
    return {
        "right": ratio(sum(e <= pipeline.place_radius_px for e in errors), count),
        "median_px": percentile(finite, 50),
        "p90_px": percentile(finite, 90),
        "sure_and_wrong": ratio(sure_and_wrong, count),
        "honest": ratio(honest, count),
        "nothing_to_see": ratio(blank, count),
    }


def _is_sure(answer: Answer) -> bool:
    return bool(answer.hypotheses) and answer.hypotheses[0].probability >= _SURE


if __name__ == "__main__":
    main()
