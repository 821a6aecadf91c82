"""Settings of these tests."""

import pytest

from webapp.settings import ExtractSettings, Settings


@pytest.fixture(scope="session")
def quick() -> Settings:
    """Settings with few keypoints."""
    return Settings(extract=ExtractSettings(max_side_px=320, keypoints=120))
