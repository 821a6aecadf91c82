"""Control points clicked in rendered photos align the joined photos with the map."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.tasks.landmarks.rendered import FOCAL, PIXELS_PER_METRE, TALL, WIDTH, walk
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick
from webapp.core.mapmodel.model import Experience, UnplacedPhoto
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.accuracy import accuracy_of
from webapp.tasks.landmarks.adjust import _key_of
from webapp.tasks.landmarks.control_points import found_points, residuals_of
from webapp.tasks.landmarks.known import known_positions
from webapp.tasks.landmarks.place_rest import georegister_found, suggest_from
from webapp.tasks.landmarks.reconstruct import SURROUNDINGS, reconstruct
from webapp.tasks.localize.index_location import landmarks_folder

METRIC = Georeference("EPSG:32633", (0.05, 0.0, 458000.0, 0.0, -0.05, 5549000.0, 0.0, 0.0, 1.0), "affine")
AT, HEADINGS = walk(9)
SPOTS = {
    "drain": (9.0, 2.0, 1.6),
    "lamp": (13.0, 0.5, -4.0),
    "sign": (16.0, 3.0, -1.0),
    "step": (6.0, 1.0, 1.4),
}
"""Offsets to the east, south and below the cameras, metres."""


def click(number, spot):
    """Return the pixel of a spot in a photo; None if not visible."""
    (x, y), heading = AT[number], HEADINGS[number]
    east, south, down = spot[0] - x, spot[1] - y, spot[2]
    sine, cosine = math.sin(heading), math.cos(heading)
    right, front = cosine * east + sine * south, sine * east - cosine * south
    share = 0.5 + FOCAL * right / front / WIDTH, 0.5 + FOCAL * down / front / TALL
    inside = front > 0.1 and all(0.0 <= value <= 1.0 for value in share)
    return PhotoClick(number, *share) if inside else None


def point(name, *, most=4):
    """Return a control point, clicked in photos that show it."""
    east, south, down = SPOTS[name]
    seen = [one for number in range(9) if (one := click(number, SPOTS[name])) is not None]
    chosen = tuple(seen[n] for n in np.unique(np.linspace(0, len(seen) - 1, most).astype(int)))
    at = MapPixel(PIXELS_PER_METRE * east, PIXELS_PER_METRE * south)
    return GroundControlPoint(name, at, chosen, accuracy_m=0.02, height_m=200.0 - down)


@pytest.fixture
def unplaced(court):
    """The georeferenced map of the court with all photos in the tray, and a function that joins it."""
    the_map = read_map(court.cfg)
    tray = tuple(UnplacedPhoto(e.id, e.photo, fov_deg=e.fov_deg) for e in the_map.experiences)
    return replace(the_map, experiences=(), unplaced=(*tray, *the_map.unplaced), georeference=METRIC)


def join(court, the_map, **options):
    return reconstruct(court.cfg, the_map, settings=Settings(), progress=Progress(), **options)


def test_three_points_place_all_photos_to_a_decimetre(court, unplaced):
    the_map = replace(unplaced, control_points=tuple(point(name) for name in ("drain", "lamp", "sign")))
    report = suggest_from(join(court, the_map), the_map)
    off = {
        one.id: math.dist(one.position, PIXELS_PER_METRE * AT[one.id]) / PIXELS_PER_METRE
        for one in report.suggested
    }
    assert sorted(off) == [*range(9)]
    assert max(off.values()) <= 0.1


def test_a_point_at_a_wrong_place_and_a_wrong_click_are_named(court, unplaced):
    points = [point(name) for name in SPOTS]
    points[3] = replace(points[3], position=MapPixel(points[3].position.x + 60.0, points[3].position.y))
    first = points[0].clicks[0]
    points[0] = replace(points[0], clicks=(first._replace(y=first.y - 0.2), *points[0].clicks[1:]))
    the_map = replace(unplaced, control_points=tuple(points))
    found = join(court, the_map)
    residuals = residuals_of(
        found.submodels, georegister_found(found, the_map), photos=found.photos, the_map=the_map
    )
    assert [one.name for one in residuals if one.contradicts] == ["step"]
    assert residuals[0].name == "step"
    assert residuals[0].residual_m(the_map) == pytest.approx(3.0, abs=0.2)
    assert {one.name: one.wrong for one in residuals if one.wrong} == {"drain": (found_name(the_map, first),)}


def test_clicks_have_rays_in_a_reconstruction_of_some_photos_too(court, unplaced):
    the_map = replace(unplaced, control_points=(point("drain"),))
    part = join(court, the_map, part=landmarks_folder(court.cfg) / SURROUNDINGS / "part")
    [known] = found_points(part, the_map)
    assert len(known.ray) == len(the_map.control_points[0].clicks) == 4


def test_check_points_of_known_errors_give_the_known_rmse(court, unplaced):
    fitted = tuple(point(name) for name in ("drain", "lamp", "sign"))
    wrong = (
        step(),
        step(name="north", north_m=1.0),
        step(name="east", east_m=1.0),
        step(name="up", up_m=0.5),
    )
    the_map = replace(unplaced, control_points=(*fitted, *wrong))
    found = join_and_judge(court, the_map)
    east, north = found["step"].shift_m(the_map)
    assert math.hypot(east, north) < 0.1
    # within 1 %: the image is north up in UTM, half a degree from true north
    assert found["east"].shift_m(the_map) == pytest.approx((east - 1.0, north), abs=0.01)
    assert found["north"].shift_m(the_map) == pytest.approx((east, north - 1.0), abs=0.01)
    up = found["up"].in_metres(found["up"].height_off_px, the_map)
    assert up == pytest.approx(-0.5, abs=0.05)
    accuracy = accuracy_of(found.values(), the_map)
    assert (accuracy.check.points, accuracy.check.heights) == (4, 4)
    assert accuracy.check.m == pytest.approx(math.sqrt(2.0 / 4.0), abs=0.05)
    assert accuracy.check.east_m == pytest.approx(0.5, abs=0.05)
    assert accuracy.check.north_m == pytest.approx(0.5, abs=0.05)
    assert accuracy.check.height_m == pytest.approx(0.5 / 2.0, abs=0.05)
    assert accuracy.check.uncertainty == 0.25
    assert (accuracy.control.points, accuracy.control.m < 0.1) == (3, True)
    assert {name: one.photos for name, one in found.items()}["up"] == 4


def test_the_adjustment_does_not_see_a_check_point(court, unplaced):
    fitted = tuple(point(name) for name in ("drain", "lamp", "sign"))
    found = join(court, unplaced)
    known = known_positions(found.photos, unplaced)
    keys = {
        _key_of(known, replace(unplaced, control_points=(*fitted, *checks)))
        for checks in ((), (step(),), (step(east_m=3.0),))
    }
    assert len(keys) == 1
    assert _key_of(known, replace(unplaced, control_points=(*fitted, point("step")))) not in keys


def join_and_judge(court, the_map):
    found = join(court, the_map)
    residuals = residuals_of(
        found.submodels, georegister_found(found, the_map), photos=found.photos, the_map=the_map
    )
    return {one.name: one for one in residuals if one.photo is None}


def step(name="step", *, east_m=0.0, north_m=0.0, up_m=0.0):
    """Return a check point whose surveyed position is wrong by some metres."""
    true = point("step")
    at = MapPixel(true.position.x + PIXELS_PER_METRE * east_m, true.position.y - PIXELS_PER_METRE * north_m)
    return replace(true, name=name, position=at, height_m=true.height_m + up_m, is_check=True)


def found_name(the_map, click):
    return next(photo.photo for photo in the_map.unplaced if photo.id == click.photo)


def test_a_point_that_takes_no_part_says_why(court, unplaced):
    drain = point("drain")
    points = (
        replace(drain, name="a", clicks=drain.clicks[:1]),
        replace(drain, name="b", position=None),
        replace(drain, name="c", clicks=()),
    )
    the_map = replace(unplaced, control_points=points)
    found = join(court, the_map)
    residuals = residuals_of(
        found.submodels, georegister_found(found, the_map), photos=found.photos, the_map=the_map
    )
    name = found_name(the_map, drain.clicks[0])
    assert [one.problem for one in residuals] == [
        f"it is clicked in one joined photo only, {name}: click it in two or more",
        "it is not on the map yet",
        "it is not clicked in any joined photo: click it in two or more",
    ]


def test_placed_photos_and_points_are_judged_together(court, unplaced):
    placed = [Experience(n, f"photos/{n:02}.png", MapPixel(*(PIXELS_PER_METRE * AT[n]))) for n in (0, 4)]
    placed[1] = replace(placed[1], position=MapPixel(placed[1].position.x + 40.0, placed[1].position.y))
    the_map = replace(
        unplaced,
        experiences=tuple(placed),
        unplaced=tuple(one for one in unplaced.unplaced if one.id not in (0, 4)),
        control_points=tuple(point(name) for name in SPOTS),
    )
    found = join(court, the_map)
    residuals = residuals_of(
        found.submodels, georegister_found(found, the_map), photos=found.photos, the_map=the_map
    )
    assert (residuals[0].photo, residuals[0].contradicts) == (4, True)
    assert residuals[0].residual_m(the_map) == pytest.approx(2.0, abs=0.2)
    assert not any(one.contradicts for one in residuals[1:])
