"""The two pictures of an answer: the places on the map, and the matches with its best photo."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from webapp.core.hypotheses.model import Answer, Evidence
from webapp.core.mapmodel.model import Map
from webapp.files.maps.folder import boxes_in_file, photo_path
from webapp.files.photos.photo import read_blurred, read_upright
from webapp.render.canvas import Canvas, Point, shortened, text_width
from webapp.render.colours import INK, INLIER, OUTLIER, PAPER, QUIET
from webapp.render.map_picture import draw_map
from webapp.settings import PhotoLimits

WIDTH_PX = 1600
HEIGHT_PX = 640
"""The two photos are scaled to one height, as large as fits into this."""

GAP_PX = 8
BAND_PX = 76
_TEXT, _SMALL, _MARGIN = 19, 16, 14


def map_picture(cfg: Path, the_map: Map, *, answer: Answer, limits: PhotoLimits) -> Image.Image:
    """Draw the hypotheses on the satellite image.

    Raises:
        PhotoError: The satellite image cannot be used.
        MapError: Its path leads out of the map's folder.
    """
    satellite = read_upright(photo_path(cfg, the_map.satellite.path), limits=limits)
    return draw_map(satellite, the_map, answer=answer)


def match_picture(
    cfg: Path, the_map: Map, *, query: Path, answer: Answer, limits: PhotoLimits
) -> Image.Image | None:
    """Draw the query next to the best photo of the map; None when there is no match to show.

    Raises:
        PhotoError: One of the photos cannot be used.
        MapError: The photo's path leads out of the map's folder.
    """
    if not answer.evidence:
        return None
    best = answer.evidence[0]
    photo = next(e for e in the_map.experiences if e.id == best.experience)
    return draw_matches(
        read_blurred(query, boxes_in_file(cfg.parent, the_map, file=query), limits=limits),
        read_blurred(photo_path(cfg, photo.photo), photo.blurred, limits=limits),
        evidence=best,
        query_name=query.name,
        photo_name=photo.photo,
    )


def draw_matches(
    query: NDArray[np.uint8],
    photo: NDArray[np.uint8],
    *,
    evidence: Evidence,
    query_name: str,
    photo_name: str,
) -> Image.Image:
    """Draw the matches between a query and a photo of the map.

    Args:
        query, photo: (height, width, 3) uint8. Upright, at full size; blue, green, red.

    Returns:
        RGB. The query is on the left, the caption in a band below.
    """
    left, right = _scales(query, photo)
    left_image, right_image = _scaled(query, left), _scaled(photo, right)
    height = left_image.shape[0]
    offset = left_image.shape[1] + GAP_PX
    width = offset + right_image.shape[1]
    canvas = Canvas(np.full((height + BAND_PX, width, 3), PAPER, dtype=np.uint8))
    canvas.paste(left_image, at=(0, 0))
    canvas.paste(right_image, at=(offset, 0))
    ends = [
        (_shown(a, left, 0), _shown(b, right, offset))
        for a, b in zip(evidence.query_xy, evidence.photo_xy, strict=True)
    ]
    inliers = [pair for pair, inlier in zip(ends, evidence.inlier, strict=True) if inlier]
    others = [pair for pair, inlier in zip(ends, evidence.inlier, strict=True) if not inlier]
    # Without inliers, the other matches are drawn more strongly.
    with canvas.faint(0.3 if inliers else 0.7):
        _join(canvas, others, OUTLIER)
    with canvas.faint(0.9):
        _join(canvas, inliers, INLIER)
    _caption(
        canvas, (query_name, f"Experience {evidence.experience}: {photo_name}"), offset=offset, height=height
    )
    _counts(canvas, inliers=len(inliers), others=len(others), height=height)
    return canvas.image()


def _scales(query: NDArray[np.uint8], photo: NDArray[np.uint8]) -> tuple[float, float]:
    """Return the scales that make both photos equally high and fit them into the picture."""
    aspects = [image.shape[1] / image.shape[0] for image in (query, photo)]
    height = min(HEIGHT_PX, (WIDTH_PX - GAP_PX) / sum(aspects))
    return height / query.shape[0], height / photo.shape[0]


def _scaled(image: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    height, width = (max(1, round(side * scale)) for side in image.shape[:2])
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    resized = cv2.resize(image, (width, height), interpolation=way)
    return np.asarray(cv2.cvtColor(resized, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _shown(xy: NDArray[np.float32], scale: float, offset: int) -> Point:
    """Return a keypoint of the full-size photo in the picture; both count from pixel centres."""
    x, y = ((float(v) + 0.5) * scale - 0.5 for v in xy)
    return x + offset, y


def _join(canvas: Canvas, pairs: list[tuple[Point, Point]], colour: tuple[int, int, int]) -> None:
    for start, end in pairs:
        canvas.line(start, end, colour=colour)
    for point in (point for pair in pairs for point in pair):
        canvas.ring(point, 3, colour=colour)


def _caption(canvas: Canvas, names: tuple[str, str], *, offset: int, height: int) -> None:
    baseline = height + 30
    half = [(_MARGIN, offset - 2 * _MARGIN), (offset + _MARGIN, canvas.size[0] - offset - 2 * _MARGIN)]
    for name, (x, width) in zip((f"Query: {names[0]}", names[1]), half, strict=True):
        canvas.text((x, baseline), shortened(name, _TEXT, width=width), size=_TEXT)


def _counts(canvas: Canvas, *, inliers: int, others: int, height: int) -> None:
    baseline, x = height + 58, float(_MARGIN)
    total = f"{inliers + others} matches"
    canvas.text((x, baseline), total, size=_SMALL, colour=QUIET)
    x += text_width(total, _SMALL) + 28
    legend = ((INLIER, f"{inliers} inliers"), (OUTLIER, f"{others} others"))
    for colour, words in legend:
        for shade, width in ((INK, 5), (colour, 3)):
            canvas.line((x + 2, baseline - 5), (x + 22, baseline - 5), colour=shade, width=width)
        canvas.text((x + 34, baseline), words, size=_SMALL, colour=QUIET)
        x += 34 + text_width(words, _SMALL) + 28
