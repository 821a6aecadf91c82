"""A cloud and its cameras in the frame of their map."""

import numpy as np
import pytest

from tests.core.landmarks.scene import known_at, level_cameras, random_rotation
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.core.landmarks.cloud import CloudFrame, LandmarkCloud, align_cloud
from webapp.core.landmarks.placing import NotAligned, align_submodel
from webapp.core.landmarks.submodels import Submodel

SIZE = (1000, 800)
PARK = LatLon(50.2, 14.4)
HEADINGS = np.array([0.0, 0.5, 1.2, 2.0, 3.0, 4.5])
AT = np.array([100, 300 + 50j, 480 + 200j, 500 + 400j, 350 + 520j, 150 + 600j])


@pytest.fixture
def scene(rng):
    """Return points, (k, 3) map pixels including heights, seen by level cameras, in their own frame."""
    truth = np.column_stack([rng.uniform(0, 700, 40), rng.uniform(0, 700, 40), rng.uniform(-20, 90, 40)])
    turn, scale, shift = random_rotation(rng), 0.037, rng.normal(0.0, 5.0, 3)

    def world(x, y, up):
        return scale * np.stack([x, -up, -y], -1) @ turn.T + shift

    submodel = Submodel(
        np.arange(len(AT)), world(AT.real, AT.imag, 0.0 * AT.real), level_cameras(HEADINGS) @ turn.T
    )
    seen = [np.sort(rng.choice(40, 25, replace=False)) for _ in AT]
    seen[0], seen[1] = np.arange(40), np.arange(40)
    rows = np.concatenate(seen).astype(np.int32)
    cloud = LandmarkCloud(
        tuple("abcdef"),
        world(*truth.T),
        np.zeros(40, np.int32),
        np.cumsum([0, *map(len, seen)]),
        rows,
        np.zeros((len(rows), 2), np.float32),
        np.zeros((len(rows), 128), np.uint8),
        np.ones(len(AT)),
        np.zeros(len(AT)),
    )
    return cloud, submodel, truth


def aligned(submodel, which=(0, 1, 2, 3, 4, 5)):
    return align_submodel(submodel, known_at(AT, list(which)))


def test_points_and_cameras_come_where_they_are(scene):
    cloud, submodel, truth = scene
    found = align_cloud(
        cloud, [submodel], aligned=[aligned(submodel, (0, 2, 4))], frame=CloudFrame(None, SIZE)
    )
    assert found.point.tolist() == list(range(40))
    assert found.xyz == pytest.approx(truth * (1, -1, 1) + (-500, 400, 0), abs=1e-6)
    assert found.centre == pytest.approx(
        np.column_stack([AT.real - 500, 400 - AT.imag, 0 * AT.real]), abs=1e-6
    )
    front = np.column_stack([np.sin(HEADINGS), np.cos(HEADINGS), 0 * HEADINGS])
    right = np.column_stack([np.cos(HEADINGS), -np.sin(HEADINGS), 0 * HEADINGS])
    assert found.rotation[:, 0] == pytest.approx(right, abs=1e-6)
    assert found.rotation[:, 1] == pytest.approx(np.tile([0.0, 0.0, -1.0], (6, 1)), abs=1e-6)
    assert found.rotation[:, 2] == pytest.approx(front, abs=1e-6)
    assert found.ground == pytest.approx(np.percentile(truth[:, 2], 5), abs=1e-6)


def test_a_georeference_makes_them_metres_east_north_and_up(scene):
    cloud, submodel, truth = scene
    turned = Georeference(
        LocalFrame(PARK).plane, (0.3, 0.4, 7.0, 0.4, -0.3, 5.0, 0.0, 0.0, 1.0), "similarity"
    )
    shown = CloudFrame(turned, SIZE)
    found = align_cloud(cloud, [submodel], aligned=[aligned(submodel)], frame=shown)
    assert shown.unit == "m"
    plane = turned.enu_from_pixel(truth[:, :2], LocalFrame(shown.origin))
    assert found.xyz[:, :2] == pytest.approx(plane, abs=1e-4)
    assert found.xyz[:, 2] == pytest.approx(0.5 * truth[:, 2], abs=1e-4)
    assert np.einsum("nij,nkj->nik", found.rotation, found.rotation) == pytest.approx(
        np.tile(np.eye(3), (6, 1, 1)), abs=1e-4
    )
    # up in the image is 53 degrees west of north
    assert found.rotation[0, 2] == pytest.approx([-0.8, 0.6, 0.0], abs=1e-4)


def test_a_point_that_is_far_off_is_left_out(scene):
    cloud, submodel, _ = scene
    cloud.point[5] += 1e4
    found = align_cloud(cloud, [submodel], aligned=[aligned(submodel)], frame=CloudFrame(None, SIZE))
    assert found.point.tolist() == [n for n in range(40) if n != 5]


def test_a_submodel_that_cannot_be_laid_is_left_out(scene):
    cloud, submodel, _ = scene
    reason = NotAligned("none of them is placed")
    found = align_cloud(cloud, [submodel], aligned=[reason], frame=CloudFrame(None, SIZE))
    assert (len(found.point), len(found.photo), found.ground) == (0, 0, 0.0)
