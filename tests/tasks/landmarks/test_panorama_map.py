"""Panoramas of a rendered court: the views of each are one camera, and are placed together."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.tasks.landmarks.rendered import PIXELS_PER_METRE, SIDE, render_panorama
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage, UnplacedPhoto
from webapp.core.mapmodel.panorama import Panorama
from webapp.files.maps.folder import read_map, write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.adjust import adjust_submodels
from webapp.tasks.landmarks.control_points import residuals_of
from webapp.tasks.landmarks.place_rest import georegister_found, suggest_rest
from webapp.tasks.landmarks.reconstruct import reconstruct

pytestmark = pytest.mark.slow

PANORAMAS, PLACED = 5, (0, 2, 4)


@pytest.fixture(scope="module")
def court(tmp_path_factory):
    """A map of panoramas, three of them placed; their positions, and the headings of their middles."""
    folder = tmp_path_factory.mktemp("around")
    angle = np.linspace(0.2, 2.4, PANORAMAS)
    at = np.stack([SIDE / 2 + 4.0 * np.cos(angle), SIDE / 2 + 3.0 * np.sin(angle)], 1)
    headings = np.linspace(20.0, 130.0, PANORAMAS)
    (folder / "photos").mkdir()
    names = [f"photos/{number}.png" for number in range(PANORAMAS)]
    for name, (x, y), heading in zip(names, at, headings, strict=True):
        cv2.imwrite(str(folder / name), render_panorama(x, y, np.radians(heading), wide=1200))
    cv2.imwrite(str(folder / "plan.png"), np.full((400, 400), 200, np.uint8))
    placed = (
        Experience(n, names[n], MapPixel(*(PIXELS_PER_METRE * at[n])), fov_deg=360.0, panorama=Panorama())
        for n in PLACED
    )
    others = (
        UnplacedPhoto(n, names[n], fov_deg=360.0, panorama=Panorama())
        for n in range(PANORAMAS)
        if n not in PLACED
    )
    cfg = folder / "map.cfg"
    write_map(
        cfg,
        Map(SatelliteImage("plan.png", 400, 400), tuple(placed), unplaced=tuple(others), next_id=PANORAMAS),
    )
    return cfg, at, headings


def test_panoramas_are_placed_as_one_to_a_decimetre(court):
    cfg, at, headings = court
    report = suggest_rest(cfg, settings=Settings(), progress=Progress())
    assert [one.id for one in report.suggested] == [1, 3], "one suggestion for each panorama"
    assert (report.left, [one.id for one in report.checked]) == ((), [*PLACED])
    off = [np.array(one.position) / PIXELS_PER_METRE - at[one.id] for one in report.suggested]
    turned = [(one.heading_deg - headings[one.id] + 180.0) % 360.0 - 180.0 for one in report.suggested]
    assert np.median(np.hypot(*np.transpose(off))) <= 0.1
    assert np.median(np.abs(turned)) <= 0.2


def clicked(at, headings, spot):
    """Return the pixel of a spot in each panorama; the spot is east, south and below the cameras, metres."""
    east, south = (spot[:2] - at).T
    turned = np.degrees(np.arctan2(east, -south)) - headings
    down = np.degrees(np.arctan2(spot[2], np.hypot(east, south)))
    share = np.stack([(0.5 + turned / 360.0) % 1.0, 0.5 + down / 180.0], 1)
    return tuple(PhotoClick(number, float(x), float(y)) for number, (x, y) in enumerate(share))


def test_a_control_point_takes_part_in_their_adjustment(court, tmp_path):
    cfg, at, headings = court
    shutil.copytree(cfg.parent, tmp_path / "court")
    cfg = tmp_path / "court" / "map.cfg"
    # also a corner behind the panoramas, whichever view shows it
    spots = {"corner": (0.5, 0.5, 1.0), "pole": (SIDE - 1.0, 2.0, -2.0)}
    points = tuple(
        GroundControlPoint(
            name, MapPixel(*(PIXELS_PER_METRE * np.array(spot[:2]))), clicked(at, headings, spot)
        )
        for name, spot in spots.items()
    )
    the_map = replace(read_map(cfg), control_points=points)
    joined, (submodel,) = adjust_submodels(
        reconstruct(cfg, the_map, settings=Settings(), progress=Progress()), the_map, progress=Progress()
    )
    assert (submodel.problem, len(submodel.photos)) == ("", PANORAMAS)
    residuals = residuals_of(
        joined.submodels, georegister_found(joined, the_map), photos=joined.photos, the_map=the_map
    )
    assert {one.name: one.problem for one in residuals if one.name in spots} == {"corner": None, "pole": None}
    assert max(one.residual_px for one in residuals) < 0.1 * PIXELS_PER_METRE


def test_a_view_that_shows_nothing_of_the_others_stays_with_its_panorama(court, tmp_path):
    folder = tmp_path / "masked"
    shutil.copytree(court[0].parent, folder, ignore=shutil.ignore_patterns("derived"))
    for name in (folder / "photos").iterdir():
        pixels = cv2.imread(str(name))
        pixels[:, 500:700] = 128
        cv2.imwrite(str(name), pixels)
    report = suggest_rest(folder / "map.cfg", settings=Settings(), progress=Progress())
    assert [one.id for one in report.suggested] == [1, 3]
