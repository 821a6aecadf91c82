"""The picture of raw and corrected tracks."""

import numpy as np
import pytest

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.render.track_picture import BAND_PX, COLOURS, GATED, SIDE_PX, Shown, draw_tracks
from webapp.render.colours import PAPER

FRAME = LocalFrame(LatLon(50.0, 14.0))


def poses(enu, *, sigma=None, times=None):
    enu = np.array(enu, dtype=float)
    covariance = None if sigma is None else np.tile([sigma**2, sigma**2, 0.0], (len(enu), 1))
    latlon = FRAME.latlon_from_enu(enu)
    return make_poses(np.arange(len(enu)) if times is None else times, latlon, covariance_m2=covariance)


def where(picture, colour):
    """Return the pixels (n, 2) of a colour above the legend: column, row."""
    pixels = np.asarray(picture)[:-BAND_PX]
    return np.argwhere((np.abs(pixels.astype(int) - colour) < 6).all(axis=2))[:, ::-1]


def test_north_is_up_and_east_is_right():
    picture = draw_tracks(Shown([("odometry", poses([(0, 0), (0, 100)])), ("gps", poses([(60, 0)]))]))
    line, dot = where(picture, COLOURS["odometry"]), where(picture, COLOURS["gps"])
    assert np.ptp(line[:, 1]) == pytest.approx(SIDE_PX - 80, abs=4)
    assert np.ptp(line[:, 0]) < 5
    assert dot[:, 0].mean() - line[:, 0].mean() == pytest.approx(0.6 * (SIDE_PX - 80), abs=5)
    assert dot[:, 1].mean() == pytest.approx(line[:, 1].max(), abs=5)


def test_what_was_left_out_is_crossed_and_tied_to_where_it_should_be():
    gated = tuple(LatLon(*p) for p in FRAME.latlon_from_enu([(80, 80), (0, 50)]).tolist())
    picture = draw_tracks(Shown([("gps", poses([(0, 0), (0, 100)]))], [gated]))
    assert len(where(picture, GATED)) > 20
    pixels = np.asarray(picture)[:-BAND_PX].astype(int)
    reddish = np.argwhere(pixels[..., 0] - pixels[..., 1:].max(axis=2) > 40)[:, ::-1]
    assert np.ptp(reddish[:, 0]) == pytest.approx(0.8 * (SIDE_PX - 80), abs=15)
    assert np.ptp(reddish[:, 1]) == pytest.approx(0.3 * (SIDE_PX - 80), abs=15)


def test_a_larger_uncertainty_is_a_larger_ellipse():
    small, large = (
        draw_tracks(Shown([("fused", poses([(0, 0), (0, 100)], sigma=sigma))])) for sigma in (1.0, 8.0)
    )
    drawn = [(np.abs(np.asarray(p)[:-BAND_PX].astype(int) - PAPER).max(axis=2) > 30) for p in (small, large)]
    widths = [np.ptp(np.flatnonzero(d.any(axis=0))) for d in drawn]
    assert widths[1] > 5 * widths[0]
    assert widths[1] / 9.2 == pytest.approx(2 * 8 * 2.45, rel=0.1)  # 9.2 pixels a metre


def test_between_pieces_there_is_no_line():
    track = poses([(0, 0), (0, 10), (100, 90), (100, 100)], sigma=0.01)
    whole, pieces = (draw_tracks(Shown([("fused", track)], pieces=begins)) for begins in ((0.0,), (0.0, 2.0)))
    assert len(where(pieces, COLOURS["fused"])) < 0.5 * len(where(whole, COLOURS["fused"]))


def test_one_pose_is_enough():
    assert draw_tracks(Shown([("visual", poses([(0, 0)]))])).width >= 640
