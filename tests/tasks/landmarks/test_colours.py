"""Colours of the court's points come from its photos."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from webapp.core.boxes import BlurBox
from webapp.files.landmarks.cloud import CLOUD_FILE, COLOURS_FILE, read_cloud, read_colours
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.tasks.landmarks.colours import colour_cloud
from webapp.tasks.landmarks.reconstruct import reconstruct


@pytest.fixture
def found(court):
    return reconstruct(court.cfg, read_map(court.cfg), settings=Settings(), progress=Progress())


def colours_of(found):
    stored = read_cloud(found.folder / CLOUD_FILE)
    return stored.cloud, read_colours(found.folder / COLOURS_FILE, key=stored.key)


def test_suggesting_places_has_sampled_the_photos(court, found):
    cloud, rgb = colours_of(found)
    assert rgb.shape == (len(cloud.point), 3)
    assert (rgb[:, 0] == rgb[:, 2]).all(), "the photos are grey"
    photo = cv2.imread(str(court.cfg.parent / "photos" / "04.png"), cv2.IMREAD_GRAYSCALE)
    number = cloud.contents.index(next(c for c, n in found.number_of.items() if n == 4))
    rows = cloud.rows_of(number)
    x, y = np.rint(cloud.seen_xy[rows]).astype(int).T
    shown = photo[y, x].astype(float)
    assert np.corrcoef(shown, rgb[cloud.seen_point[rows], 0])[0, 1] > 0.7


def test_a_photo_that_has_gone_leaves_its_points_to_the_others(court, found):
    (found.folder / COLOURS_FILE).unlink()
    (court.cfg.parent / "photos" / "00.png").unlink()
    colour_cloud(court.cfg, found, limits=PhotoLimits(), progress=Progress())
    cloud, rgb = colours_of(found)
    assert len(np.unique(rgb[cloud.seen_point[cloud.rows_of(0)]])) > 20


def test_colours_are_those_of_the_blurred_photos(court, found):
    sharp = colours_of(found)[1].astype(float).std()
    (found.folder / COLOURS_FILE).unlink()
    everything = (BlurBox(0.0, 0.0, 1.0, 1.0),)
    photos = tuple(replace(photo, blurred=everything) for photo in found.photos)
    colour_cloud(court.cfg, replace(found, photos=photos), limits=PhotoLimits(), progress=Progress())
    assert colours_of(found)[1].astype(float).std() < sharp / 2
