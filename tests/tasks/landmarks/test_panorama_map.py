"""Panoramas of a court that is rendered: the views of each are one camera, and place themselves as one."""

import shutil

import cv2
import numpy as np
import pytest

from tests.tasks.landmarks.rendered import PIXELS_PER_METRE, SIDE, render_panorama
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map, SatelliteImage, UnplacedPhoto
from webapp.core.mapmodel.panorama import Panorama
from webapp.files.maps.folder import write_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.place_rest import suggest_rest

PANORAMAS, PLACED = 5, (0, 2, 4)


@pytest.fixture(scope="module")
def court(tmp_path_factory):
    """A map of panoramas, three of them placed; where each was taken, and where its middle looks."""
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


def test_a_view_that_shows_nothing_of_the_others_stays_with_its_panorama(court, tmp_path):
    folder = tmp_path / "masked"
    shutil.copytree(court[0].parent, folder, ignore=shutil.ignore_patterns("derived"))
    for name in (folder / "photos").iterdir():
        pixels = cv2.imread(str(name))
        pixels[:, 500:700] = 128
        cv2.imwrite(str(name), pixels)
    report = suggest_rest(folder / "map.cfg", settings=Settings(), progress=Progress())
    assert [one.id for one in report.suggested] == [1, 3]
