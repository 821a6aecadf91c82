"""The health of a map, from localizing its own photos."""

import cv2
import pytest

from webapp.errors import StorageError
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.maps import health


def test_places_that_look_alike_are_found_and_remembered(make_map, tmp_path):
    cfg = make_map(tmp_path / "park", 5)
    twin = cv2.imread(str(cfg.parent / "photos" / "0.jpg"))
    cv2.imwrite(str(cfg.parent / "photos" / "twin.jpg"), twin, [cv2.IMWRITE_JPEG_QUALITY, 80])
    lines = [f"{n};photos/{n}.jpg;{100 + 20 * n};100" for n in range(5)]
    cfg.write_text("\n".join(["plan.png;600;200", *lines, "9;photos/twin.jpg;590;100"]) + "\n")
    settings = Settings(extract=ExtractSettings(max_side_px=320, keypoints=120))
    assert health.read_health(cfg) is None
    content = health.find_weak_places(
        cfg, settings=settings, progress=Progress(), options=OpenOptions(method="vote", jobs=1)
    )
    assert content["place_radius_px"] == 40
    found = {photo["id"]: (photo["state"], photo["taken_for"]) for photo in content["photos"]}
    assert (found[0], found[9]) == (("confusable", 9), ("confusable", 0))
    assert health.read_health(cfg) == content


def test_a_damaged_record_is_reported(make_map, tmp_path):
    cfg = make_map(tmp_path / "park", 1)
    (cfg.parent / "derived").mkdir()
    (cfg.parent / "derived" / "health.json").write_text("{")
    with pytest.raises(StorageError):
        health.read_health(cfg)
    (cfg.parent / "derived" / "health.json").write_text('{"version": 0}')
    assert health.read_health(cfg) is None
