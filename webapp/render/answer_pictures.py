"""The two pictures of an answer, made from the files."""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from webapp.core.hypotheses.model import Answer
from webapp.core.mapmodel.model import Map
from webapp.files.maps.folder import photo_path
from webapp.files.photos.photo import read_upright
from webapp.render.map_picture import draw_map
from webapp.render.match_picture import draw_matches
from webapp.settings import PhotoLimits


def map_picture(cfg: Path, the_map: Map, *, answer: Answer, limits: PhotoLimits) -> Image.Image:
    """Draw the hypotheses on the satellite image.

    Raises
    ------
    PhotoError
        The satellite image cannot be used.
    MapError
        Its path leads out of the map's folder.
    """
    satellite = read_upright(photo_path(cfg, the_map.satellite.path), limits=limits)
    return draw_map(satellite, the_map, answer=answer)


def match_picture(
    cfg: Path, the_map: Map, *, query: Path, answer: Answer, limits: PhotoLimits
) -> Image.Image | None:
    """Draw the query beside the best photo of the map; None when there is no match to show.

    Raises
    ------
    PhotoError
        One of the photos cannot be used.
    MapError
        The photo's path leads out of the map's folder.
    """
    if not answer.evidence:
        return None
    best = answer.evidence[0]
    photo = next(e.photo for e in the_map.experiences if e.id == best.experience)
    return draw_matches(
        read_upright(query, limits=limits),
        read_upright(photo_path(cfg, photo), limits=limits),
        evidence=best,
        query_name=query.name,
        photo_name=photo,
    )
