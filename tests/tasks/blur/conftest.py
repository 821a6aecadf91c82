"""A map whose photos have a white spot, which the stand-in networks detect as a face and a plate."""

import cv2
import numpy as np
import pytest

from tests.standin_models import install_blur_networks
from webapp.files.localize.models import blur_networks


@pytest.fixture
def models(tmp_path, monkeypatch):
    """The folder of the stand-ins."""
    return install_blur_networks(tmp_path / "models", monkeypatch.setitem)


@pytest.fixture
def networks(models):
    return blur_networks(models)


@pytest.fixture
def spotted(make_map):
    """Make a map of photos with a spot at (200, 104), except in the first one, and return the .cfg."""

    def make(folder, photos):
        cfg = make_map(folder, photos)
        for number in range(photos):
            pixels = np.full((240, 320, 3), 3 * number, np.uint8)
            if number:
                pixels[96:112, 192:208] = 220
            cv2.imwrite(str(folder / "photos" / f"{number}.jpg"), pixels, [cv2.IMWRITE_JPEG_QUALITY, 98])
        return cfg

    return make
