"""How well the placed photos and control points of a map fit its landmarks as they are on the disk."""

from __future__ import annotations

from pathlib import Path

from webapp.core.mapmodel.model import Map
from webapp.core.mapmodel.views import content_of, level_views
from webapp.files.landmarks.cloud import CLOUD_FILE, read_cloud
from webapp.files.landmarks.colmap import SUBMODELS_FILE, read_submodels
from webapp.files.maps.folder import photo_hash
from webapp.tasks.landmarks.control_points import PhotoLenses, Residual, georegister_all, residuals_of
from webapp.tasks.landmarks.known import all_photos
from webapp.tasks.localize.index_location import landmarks_folder


def stored_residuals(cfg: Path, the_map: Map) -> list[Residual] | None:
    """List how well known positions fit the landmarks of a map that are there; None where there are none.

    Raises
    ------
    MapError
    """
    folder = landmarks_folder(cfg)
    stored, submodels = read_cloud(folder / CLOUD_FILE), read_submodels(folder / SUBMODELS_FILE)
    if stored is None or submodels is None or stored.key != submodels.cloud_key:
        return None
    photos = {content_of(one, photo_hash(cfg, one.photo)): one for one in level_views(all_photos(the_map))}
    of_cloud = [photos.get(content) for content in submodels.contents]
    lenses = PhotoLenses(folder, stored.cloud, dict(enumerate(submodels.contents)))
    results = georegister_all(submodels.submodels, of_cloud, the_map=the_map, lenses=lenses)
    return residuals_of(submodels.submodels, results, photos=of_cloud, the_map=the_map)
