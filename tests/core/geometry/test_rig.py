"""Photos of a rig are joined to a panorama with every direction at its place."""

import numpy as np
import pytest

from tests.core.geometry.rig_photos import FOV_DEG, SIX, photo_of, to_rig
from webapp.core.geometry.rig import RigCamera, RigPhoto, join, panorama_width

WIDE = 1440


def panorama_of(spots, mounted, **lens):
    photos = [
        RigPhoto(photo_of(spots, one, **lens), RigCamera(*one, lens.get("fov_deg", FOV_DEG)))
        for one in mounted
    ]
    return join(photos, WIDE)


def found_at(panorama, x, y, reach=12):
    """Return the centre of brightness around a pixel."""
    columns, rows = (
        np.arange(round(x) - reach, round(x) + reach + 1),
        np.arange(round(y) - reach, round(y) + reach + 1),
    )
    light = np.clip(panorama[rows[:, None], columns % WIDE, 0].astype(float) - 40.0, 0, None)
    return (light.sum(0) @ columns) / light.sum(), (light.sum(1) @ rows) / light.sum()


@pytest.mark.parametrize(
    ("mounted", "spots"),
    [
        (SIX, [(0, 0), (30, 10), (-100, -20), (90, 25), (179.5, 5)]),
        (
            [(20.0, 15.0, 0.0), (140.0, -10.0, 30.0), (260.0, 5.0, -90.0)],
            [(20, 15), (35, 5), (140, -20), (255, 20)],
        ),
        ([(0.0, 60.0, 180.0)], [(0, 50), (10, 62)]),
    ],
)
def test_a_direction_lands_at_its_pixel(mounted, spots):
    panorama, seen = panorama_of(spots, mounted)
    for longitude, elevation in spots:
        x = ((longitude / 360.0 + 0.5) % 1.0) * WIDE - 0.5
        y = (0.5 - elevation / 180.0) * (WIDE // 2) - 0.5
        assert seen[round(y), round(x) % WIDE]
        np.testing.assert_allclose(found_at(panorama, x, y), (x, y), atol=0.5)


def test_the_rotation_is_that_of_three_turns():
    camera = RigCamera(70.0, -25.0, 40.0, FOV_DEG)
    np.testing.assert_allclose(camera.rotation(), to_rig(70.0, -25.0, 40.0).T, atol=1e-12)


def test_what_no_camera_sees_is_black_and_marked():
    panorama, seen = panorama_of([(0, 0)], SIX[:2])
    rows, columns = np.indices(seen.shape)
    behind = np.abs((columns + 0.5) / WIDE * 360.0 - 180.0 - 30.0) > 90.0
    above = np.abs((rows + 0.5) / (WIDE // 2) * 180.0 - 90.0) > 60.0
    assert not seen[behind].any()
    assert not seen[above].any()
    assert not panorama[~seen].any()
    assert (panorama[seen] >= 20).all()
    assert 0.1 < seen.mean() < 0.3


def test_photos_of_different_brightness_meet_softly():
    photos = [
        RigPhoto(np.full((260, 320, 3), grey, np.uint8), RigCamera(*one, FOV_DEG))
        for grey, one in zip((60, 100), SIX, strict=False)
    ]
    panorama, seen = join(photos, WIDE)
    row = panorama[WIDE // 4, :, 0].astype(int)[seen[WIDE // 4]]
    assert {int(row[0]), int(row[-1])} == {60, 100}
    assert np.abs(np.diff(row)).max() < 12


def test_the_width_is_that_of_the_finest_photo():
    photos = [
        RigPhoto(np.zeros((30, wide, 3), np.uint8), RigCamera(0.0, 0.0, 0.0, 90.0)) for wide in (40, 200)
    ]
    assert panorama_width(photos) == 628
