"""The file of a rig: contents and errors."""

import json

import pytest

from webapp.errors import InputError, MapJsonError
from webapp.files.photos.panorama import MountedCamera, photos_by_instant, read_rig


def rig(tmp_path, *cameras, **top):
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({"cameras": list(cameras), **top}))
    return path


def test_a_rig_is_read(tmp_path):
    path = rig(
        tmp_path,
        {"photos": "left/*.jpg", "yaw_deg": -60, "pitch_deg": 5, "roll_deg": 90, "fov_deg": 78.5},
        {"photos": "*_front.png", "yaw_deg": 0},
    )
    assert read_rig(path) == (
        MountedCamera("left/*.jpg", -60.0, 5.0, 90.0, 78.5),
        MountedCamera("*_front.png", 0.0, 0.0, 0.0, None),
    )


GOOD = {"photos": "a/*.jpg", "yaw_deg": 0}


@pytest.mark.parametrize(
    ("cameras", "problem"),
    [
        ([], "has 0 cameras"),
        ([GOOD, GOOD], "two cameras with the same photos"),
        ([{"photos": "a/*.jpg"}], r"cameras\[0\].yaw_deg is missing"),
        ([{"photos": "a.jpg", "yaw_deg": 0}], r"needs one \*"),
        ([{"photos": "*/*.jpg", "yaw_deg": 0}], r"needs one \*"),
        ([GOOD | {"fov_deg": 180}], "fov_deg is not from 1 to 170 degrees"),
        ([GOOD | {"pitch_deg": 100}], "pitch_deg is not from -90 to 90 degrees"),
        ([GOOD | {"yaw_deg": "left"}], "yaw_deg must be a number"),
        ([GOOD | {"lens": 1}], "unknown field 'lens'"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(tmp_path, cameras, problem):
    with pytest.raises(MapJsonError, match=problem):
        read_rig(rig(tmp_path, *cameras))


def test_a_file_that_is_none(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_rig(tmp_path / "none.json")
    (tmp_path / "rig.json").write_text("cameras:")
    with pytest.raises(MapJsonError, match="not JSON"):
        read_rig(tmp_path / "rig.json")


def test_photos_are_grouped_by_what_the_star_stands_for():
    cameras = [MountedCamera(name, 0.0, 0.0, 0.0, None) for name in ("left/*.jpg", "right/f_*.jpg")]
    names = ["left/10.jpg", "left/9.jpg", "right/f_9.jpg", "right/f_.jpg", "left/old/9.jpg", "plan.png"]
    assert photos_by_instant(cameras, names) == {
        "9": ("left/9.jpg", "right/f_9.jpg"),
        "10": ("left/10.jpg", None),
    }
    assert list(photos_by_instant(cameras, names)) == ["9", "10"]
