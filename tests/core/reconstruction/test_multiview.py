import math
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from photos_in_a_room import RADIUS, Scene, cameras, tilted

from webapp.core.localize.multiview import locate
from webapp.core.reconstruction.types import Orientations


def known(held, trust=5.0):
    count = len(held)
    return Orientations(np.array([r for r, _ in held]), np.zeros(count), np.full(count, trust))


def positions(held):
    return np.array([position for _, position in held])


@pytest.mark.parametrize("heading_deg", [10.0, 130.0, 300.0])
def test_a_query_is_located_with_its_heading(heading_deg):
    scene = Scene()
    held = cameras(scene, 40)
    query = (tilted(math.radians(heading_deg), 0.1), np.array([12.0, -20.0]))
    views = [v for n, c in enumerate(held) if len((v := scene.view(n, c, query)).query_ray) >= 20]
    best = locate(views, positions(held), orientations=known(held), place_radius_px=RADIUS)[0]
    assert math.dist((best.x, best.y), query[1]) < 0.06 * RADIUS
    assert abs(math.remainder(best.heading - math.radians(heading_deg), 2 * math.pi)) < math.radians(1.5)
    assert best.score > 1.0
    assert (np.linalg.eigvalsh(best.covariance_px2) > 0.0).all()


def test_wrong_matches_change_little():
    scene = Scene(seed=2)
    held = cameras(scene, 40, seed=3)
    query = (tilted(2.0), np.array([5.0, 8.0]))
    views = [v for n, c in enumerate(held) if len((v := scene.view(n, c, query)).query_ray) >= 20]
    rng = np.random.default_rng(0)
    for view in views:
        wrong = rng.random(len(view.query_ray)) < 0.4
        view.photo_ray[wrong, :2] = rng.uniform(-0.7, 0.7, (int(wrong.sum()), 2))
    best = locate(views, positions(held), orientations=known(held), place_radius_px=RADIUS)[0]
    assert math.dist((best.x, best.y), query[1]) < 0.15 * RADIUS


def test_without_known_orientations_there_is_no_pose():
    scene = Scene()
    held = cameras(scene, 10)
    query = (tilted(1.0), np.array([5.0, 8.0]))
    views = [scene.view(n, c, query) for n, c in enumerate(held)]
    views = [v for v in views if len(v.query_ray) >= 20]
    assert locate(views, positions(held), orientations=known(held, trust=0.1), place_radius_px=RADIUS) == []
    assert locate([], positions(held), orientations=known(held), place_radius_px=RADIUS) == []
