"""Printed tags in the photos of a map place photos, none of which is placed by hand."""

import math
from dataclasses import replace

import cv2
import numpy as np

from tests.core.tags.drawn import looking, tag_at
from tests.tasks.landmarks.rendered import FOCAL, PIXELS_PER_METRE, TALL, WIDTH, walk
from tests.tasks.landmarks.test_control_points import METRIC
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint, Tag
from webapp.core.mapmodel.model import UnplacedPhoto
from webapp.core.tags.detect import modules
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.place_rest import suggest_rest

AT, HEADINGS = walk(9)
SIZE_M = 1.2
BOARDS = {2: (9.0, 2.0, 0.9), 3: (13.0, 1.0, -2.0), 4: (16.5, 3.0, -0.6)}
"""Tags that face south: offsets to the east, south and below the cameras, metres."""


def hang(picture, centre, heading, boards):
    """Draw boards with tags into a photo, where they are in sight."""
    rotation = looking(heading)
    for number, at in boards.items():
        own = (np.array(at) + tag_at((0, 0, 0), size_m=SIZE_M).shape @ facing_south().T - centre) @ rotation.T
        pixels = FOCAL * own[:, :2] / own[:, 2:] + [(WIDTH - 1) / 2.0, (TALL - 1) / 2.0]
        if (own[:, 2] < 0.5).any() or (pixels < 0.0).any() or (pixels > [WIDTH, TALL]).any():
            continue
        black = np.pad(modules("36h11", number), 2)
        board = np.kron(np.where(black, 10, 245), np.ones((8, 8))).astype(np.uint8)
        low, high = 15.5, len(board) - 16.5
        source = np.array([[low, low], [high, low], [high, high], [low, high]], np.float32)
        warp = cv2.getPerspectiveTransform(source, pixels.astype(np.float32))
        cv2.warpPerspective(
            board, warp, (WIDTH, TALL), dst=picture, flags=cv2.INTER_AREA, borderMode=cv2.BORDER_TRANSPARENT
        )
    return picture


def facing_south():
    return np.column_stack([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)])


def point(number):
    x, y, down = BOARDS[number]
    at = MapPixel(PIXELS_PER_METRE * x, PIXELS_PER_METRE * y)
    tag = Tag("36h11", number, 1000.0 * SIZE_M, "wall", 180.0)
    return GroundControlPoint(f"tag {number}", at, (), 0.02, 200.0 - down, tag)


def test_tags_place_photos_without_a_click(court):
    the_map = read_map(court.cfg)
    photos = [*the_map.experiences, *the_map.unplaced]
    for photo in photos:
        file = court.cfg.parent / photo.photo
        picture = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        if photo.id < len(AT):
            hang(picture, np.array([*AT[photo.id], 0.0]), HEADINGS[photo.id], BOARDS)
        else:  # it shows nothing else of the court
            hang(picture, np.array([9.5, 6.0, 0.0]), 0.0, {2: BOARDS[2]})
        cv2.imwrite(str(file), picture)
    tray = tuple(UnplacedPhoto(photo.id, photo.photo, fov_deg=photo.fov_deg) for photo in photos)
    points = tuple(point(number) for number in BOARDS)
    write_map(
        court.cfg,
        replace(the_map, experiences=(), unplaced=tray, georeference=METRIC, control_points=points),
    )
    report = suggest_rest(court.cfg, settings=Settings(), progress=Progress())
    true = {**{n: tuple(AT[n]) for n in range(len(AT))}, 9: (9.5, 6.0)}
    off_m = {
        one.id: math.dist(one.position, np.array(true[one.id]) * PIXELS_PER_METRE) / PIXELS_PER_METRE
        for one in report.suggested
    }
    assert sorted(off_m) == sorted(true)
    assert max(off for id, off in off_m.items() if id < 9) <= 0.2
    alone = next(one for one in report.suggested if one.id == 9)
    assert off_m[9] <= 2.0 * alone.radius_px / PIXELS_PER_METRE < 0.5
    assert alone.placed_by == ()
