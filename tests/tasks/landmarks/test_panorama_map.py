"""Panoramas of a rendered court: the views of each are one camera, and are placed together."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.tasks.landmarks.rendered import PIXELS_PER_METRE, SIDE, render_panorama
from tests.tasks.maps.test_cut_panoramas import tilted
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.tilt import Tilt
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


TURNED = (20.0, 200.0, 80.0, 320.0, 145.0)
TILTS = (Tilt(), Tilt(12.0, -8.0), Tilt(-20.0), Tilt(5.0, 15.0), Tilt(0.0, -25.0))


@pytest.fixture(scope="module", params=["level", "turned and tilted"])
def court(tmp_path_factory, request):
    """A map of panoramas, three of them placed; their positions, and the headings of their middles."""
    is_level = request.param == "level"
    folder = tmp_path_factory.mktemp("around")
    angle = np.linspace(0.2, 2.4, PANORAMAS)
    at = np.stack([SIDE / 2 + 4.0 * np.cos(angle), SIDE / 2 + 3.0 * np.sin(angle)], 1)
    headings = np.linspace(20.0, 130.0, PANORAMAS) if is_level else np.array(TURNED)
    around = [Panorama(tilt=Tilt() if is_level else tilt) for tilt in TILTS]
    (folder / "photos").mkdir()
    names = [f"photos/{number}.png" for number in range(PANORAMAS)]
    for name, (x, y), heading, one in zip(names, at, headings, around, strict=True):
        pixels = render_panorama(x, y, np.radians(heading), wide=1200)
        tilt = np.radians([one.tilt.pitch_deg, one.tilt.roll_deg])
        cv2.imwrite(str(folder / name), tilted(pixels, *tilt) if tilt.any() else pixels)
    cv2.imwrite(str(folder / "plan.png"), np.full((400, 400), 200, np.uint8))
    placed = (
        Experience(n, names[n], MapPixel(*(PIXELS_PER_METRE * at[n])), fov_deg=360.0, panorama=around[n])
        for n in PLACED
    )
    others = (
        UnplacedPhoto(n, names[n], fov_deg=360.0, panorama=around[n])
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


def clicked(at, headings, spot, *, tilts):
    """Return the pixel of a spot in each panorama; the spot is east, south and below the cameras, metres."""
    east, south = (spot[:2] - at).T
    turned, away = np.arctan2(east, -south) - np.radians(headings), np.hypot(east, south)
    level = np.stack([away * np.sin(turned), np.full(len(at), spot[2]), away * np.cos(turned)], 1)
    clicks = []
    for number, tilt in enumerate(tilts):
        x, y, z = tilt.rotation() @ level[number]
        across, down = np.arctan2(x, z) / (2.0 * np.pi), np.arctan2(y, np.hypot(x, z)) / np.pi
        clicks.append(PhotoClick(number, float(0.5 + across) % 1.0, float(0.5 + down)))
    return tuple(clicks)


def test_a_control_point_takes_part_in_their_adjustment(court, tmp_path):
    cfg, at, headings = court
    shutil.copytree(cfg.parent, tmp_path / "court")
    cfg = tmp_path / "court" / "map.cfg"
    the_map = read_map(cfg)
    photos = {one.id: one for one in (*the_map.experiences, *the_map.unplaced)}
    tilts = [photos[number].panorama.tilt for number in range(PANORAMAS)]
    # also a corner behind the panoramas, whichever view shows it
    spots = {"corner": (0.5, 0.5, 1.0), "pole": (SIDE - 1.0, 2.0, -2.0)}
    points = tuple(
        GroundControlPoint(
            name,
            MapPixel(*(PIXELS_PER_METRE * np.array(spot[:2]))),
            clicked(at, headings, spot, tilts=tilts),
        )
        for name, spot in spots.items()
    )
    the_map = replace(the_map, control_points=points)
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
