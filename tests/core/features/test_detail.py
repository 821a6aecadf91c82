"""Photos without fine detail: enlarged or blurred ones."""

import cv2
import numpy as np
import pytest

from webapp.core.features.blank import lacks_fine_detail


@pytest.fixture(scope="module")
def scene():
    """Return a texture with the spectrum of natural images: amplitude falls with the frequency."""
    rng = np.random.default_rng(1)
    height, width = 480, 640
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    spectrum = np.fft.rfft2(rng.normal(size=(height, width))) / np.maximum(frequency, 1.0 / width)
    picture = np.fft.irfft2(spectrum, (height, width))
    return np.clip(128.0 + 40.0 * picture / picture.std(), 0, 255).astype(np.uint8)


def test_a_photo_with_all_its_detail(scene):
    assert not lacks_fine_detail(scene)
    assert not lacks_fine_detail(scene[:60, :80])


@pytest.mark.parametrize("how", [cv2.INTER_LINEAR, cv2.INTER_CUBIC, cv2.INTER_LANCZOS4])
def test_digital_zoom_is_detected(scene, how):
    assert lacks_fine_detail(cv2.resize(scene[120:360, 160:480], (640, 480), interpolation=how))


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (16, 9), (200, 300)])
def test_uniform_and_tiny_photos_are_no_zoom(size):
    assert not lacks_fine_detail(np.full(size, 90, np.uint8))
