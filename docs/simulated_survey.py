"""A robot with six cameras that never was, on its way through the park of the sample."""

from __future__ import annotations

import json
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from PIL import Image

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.files.photos.exif_write import CameraTags, exif_bytes
from webapp.files.photos.panorama import read_rig
from webapp.progress import Progress
from webapp.sample.make import SampleSize
from webapp.sample.scene.camera import CameraView, map_views
from webapp.sample.scene.plan import DEPTH_M
from webapp.sample.scene.render import render
from webapp.sample.scene.stage import AFTERNOON, set_stage
from webapp.sample.scene.world import build_world
from webapp.settings import PhotoLimits
from webapp.tasks.maps.panoramas import JoinOptions, join_panoramas

SEED = 7
"""Of the sample's park."""

CAMERAS = ("front", "right", "back-right", "back", "back-left", "left")
STARTED, EVERY = datetime(2026, 5, 1, 9, 0), timedelta(seconds=20)
FOV_DEG, SIZE = 72.0, (640, 720)


@dataclass(frozen=True, slots=True)
class SurveyPhoto:
    """A panorama of the survey, and where it was taken."""

    path: Path
    at: MapPixel
    heading_deg: float


def survey(folder: Path, georeference: Georeference, *, stops: int) -> list[SurveyPhoto]:
    """Take photos with six cameras at some stops, and join them as `expmap map join-panoramas` does."""
    step = SampleSize().metres_per_pixel
    for_world, rng, *_ = np.random.default_rng(SEED).spawn(4)
    world = build_world(for_world)
    stage = set_stage(rng, world, light=AFTERNOON)
    views = map_views(rng, world.plan, count=60)[: 6 * stops : 6]
    for number, view in enumerate(views):
        for camera, name in enumerate(CAMERAS):
            heading = view.heading_deg + 60.0 * camera
            turned = CameraView(view.east, view.north, heading, 0.0)
            photo = render(stage, turned.camera(fov_deg=FOV_DEG, width=SIZE[0], height=SIZE[1]), rng=rng)
            path = folder / "survey" / name / f"{number:04}.jpg"
            path.parent.mkdir(parents=True, exist_ok=True)
            at = georeference.latlon_of(_pixel(view, step))
            tags = CameraTags(STARTED + number * EVERY, None, at, heading % 360.0, accuracy_m=0.5)
            Image.fromarray(photo).save(path, quality=90, exif=exif_bytes(tags))
    cameras = [
        {"photos": f"{name}/*.jpg", "yaw_deg": 60 * n, "fov_deg": FOV_DEG} for n, name in enumerate(CAMERAS)
    ]
    rig = folder / "rig.json"
    rig.write_text(json.dumps({"cameras": cameras}), "utf-8")
    done = join_panoramas(
        folder / "survey",
        folder / "panoramas",
        cameras=read_rig(rig),
        options=JoinOptions(mask=folder / "mask.png"),
        limits=PhotoLimits(),
        progress=Progress(),
    )
    return [
        SurveyPhoto(folder / "panoramas" / one.panorama, _pixel(view, step), view.heading_deg)
        for one, view in zip(done, views, strict=True)
    ]


def _pixel(view: CameraView, metres_per_pixel: float) -> MapPixel:
    return MapPixel(view.east / metres_per_pixel, (DEPTH_M - view.north) / metres_per_pixel)
