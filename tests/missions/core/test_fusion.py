"""Fusion of tracks in latitude and longitude."""

import numpy as np
import pytest

from benchmarks import fusion_outliers
from tests.missions.core.simulated import Drive, rmse
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory import fusion
from webapp.missions.core.trajectory.fusion import fuse
from webapp.missions.core.trajectory.records import make_poses

FRAME = LocalFrame(LatLon(50.1, 14.4))
BEGUN_S = 1_700_000_000.0


def odometry_of(drive, *, frame=FRAME, headings=True):
    """Return the odometry of a robot that assumes its first heading to be north; anywhere on the Earth."""
    own = drive.steps.heading_rad
    moved = drive.moves[1:, :1] * np.column_stack([np.sin(own), np.cos(own)])[:-1]
    enu = np.vstack([np.zeros((1, 2)), np.cumsum(moved, axis=0)])
    result = np.degrees(own) if headings else None
    return make_poses(drive.steps.times_s + BEGUN_S, frame.latlon_from_enu(enu), heading_deg=result)


def gps_of(drive, *, stated_m=None):
    """Return the fixes of the receiver."""
    times = drive.steps.times_s[drive.node] + BEGUN_S
    variance = (drive.sigma_m if stated_m is None else stated_m) ** 2
    covariance = np.tile([variance, variance, 0.0], (len(times), 1))
    heights = np.linspace(300, 320, len(times))
    return make_poses(
        times, FRAME.latlon_from_enu(drive.measured), covariance_m2=covariance, height_m=heights
    )


def error_m(found, drive):
    """Return the error of the corrected track."""
    at = np.searchsorted(drive.steps.times_s + BEGUN_S, found.poses.times_s)
    return rmse(FRAME.enu_from_latlon(found.poses.latlon), drive.truth[at])


@pytest.mark.parametrize("frame", [FRAME, LocalFrame(LatLon(-33.0, 179.9999))])
def test_odometry_is_of_use_wherever_it_believes_to_be(frame):
    drive = Drive(1)
    found = fuse(odometry_of(drive, frame=frame), {"visual": gps_of(drive)})
    assert error_m(found, drive) < 1.0
    off = np.remainder(np.radians(found.poses.heading_deg) - drive.heading + np.pi, 2 * np.pi) - np.pi
    assert np.abs(off[50:]).max() < 0.2


def test_without_headings_they_follow_from_the_path():
    drive = Drive(1)
    assert error_m(fuse(odometry_of(drive, headings=False), {"visual": gps_of(drive)}), drive) < 1.0


def test_fixes_that_are_left_out_are_reported():
    drive = Drive(2)
    drive.measured[17] += (0, 70)
    found = fuse(odometry_of(drive), {"visual": gps_of(drive)})
    gating = found.gating["visual"]
    assert gating.number[gating.gated].tolist() == [17]
    assert gating.innovation_m[17] == pytest.approx(70, abs=6)
    away = FRAME.enu_from_latlon(gating.expected[17:18])[0] - drive.truth[drive.node[17]]
    assert np.hypot(*away) < 6
    assert gating.mean_distance < 3


def test_fixes_in_any_order_of_two_sources():
    drive = Drive(3)
    poses, rng = gps_of(drive), np.random.default_rng(0)
    mixed = poses.take(rng.permutation(len(poses)))
    visual = mixed.take(np.arange(len(mixed)) % 3 == 0)
    gps = mixed.take(np.arange(len(mixed)) % 3 != 0)
    reckoned = odometry_of(drive)
    found = fuse(reckoned.take(rng.permutation(len(reckoned))), {"gps": gps, "visual": visual})
    assert np.all(np.diff(found.poses.times_s) > 0)
    assert error_m(found, drive) < 1.5
    assert sorted(found.gating["gps"].number.tolist()) == list(range(len(gps)))
    assert np.all(np.diff(gps.times_s[found.gating["gps"].number]) > 0)


def test_a_receiver_that_promises_too_much_is_not_believed():
    drive = Drive(4, nodes=1200, every=20)
    found = fuse(odometry_of(drive), {"gps": gps_of(drive, stated_m=0.5)})
    (too_sure,) = found.fit.too_sure
    assert too_sure.source == "gps"
    assert too_sure.since_s == BEGUN_S
    assert too_sure.factor == pytest.approx(4.0, rel=0.3)
    assert not found.gating["gps"].gated.any()
    honest = fuse(odometry_of(drive), {"gps": gps_of(drive)})
    assert honest.fit.too_sure == []


def camera_of(drive, *, sigma_m, stated_m=1.0):
    """Return fixes of a camera halfway between those of the receiver."""
    at = drive.node[:-1] + drive.every // 2
    off = np.random.default_rng(drive.seed).normal(0, 1.0, (len(at), 2)) * np.reshape(sigma_m, (-1, 1))
    return make_poses(
        drive.steps.times_s[at] + BEGUN_S,
        FRAME.latlon_from_enu(drive.truth[at] + off),
        covariance_m2=np.tile([stated_m**2, stated_m**2, 0.0], (len(at), 1)),
    )


@pytest.mark.slow
def test_a_camera_that_promises_too_much_does_not_overrule_a_good_receiver():
    drive = Drive(8, nodes=1200, every=20)
    gps = gps_of(drive)
    found = fuse(odometry_of(drive), {"gps": gps, "visual": camera_of(drive, sigma_m=6.0)})
    assert found.fit.stated["gps"] < 1.5
    assert found.fit.stated["visual"] == pytest.approx(6.0, rel=0.35)
    assert [one.source for one in found.fit.too_sure] == ["visual"]
    assert error_m(found, drive) < 1.2 * error_m(fuse(odometry_of(drive), {"gps": gps}), drive)


def test_it_is_reported_since_when_a_camera_promises_too_much():
    drive = Drive(9, nodes=1200, every=20)
    sigma_m = np.where(np.arange(59) < 30, 1.0, 8.0)
    found = fuse(odometry_of(drive), {"gps": gps_of(drive), "visual": camera_of(drive, sigma_m=sigma_m)})
    (too_sure,) = found.fit.too_sure
    assert too_sure.source == "visual"
    assert too_sure.since_s == pytest.approx(BEGUN_S + 305.0, abs=40.0)
    assert too_sure.factor == pytest.approx(8.0, rel=0.35)
    first = next(one for one in found.fit.sources if one.source == "visual")
    assert first.factor < 1.5


@pytest.mark.slow
def test_two_receivers_have_errors_of_their_own():
    drive = Drive(10, nodes=1200, every=10)
    poses = gps_of(drive)
    good, bad = poses.take(np.arange(0, 120, 2)), poses.take(np.arange(1, 120, 2))
    off = np.random.default_rng(1).normal(0, 8.0, (60, 2))
    worse = make_poses(
        bad.times_s,
        FRAME.latlon_from_enu(FRAME.enu_from_latlon(bad.latlon) + off),
        covariance_m2=bad.covariance_m2,
    )
    found = fuse(odometry_of(drive), {"gps 1": good, "gps 2": worse})
    assert [one.source for one in found.fit.too_sure] == ["gps 2"]
    assert found.gating.keys() == {"gps 1", "gps 2"}


def test_a_shift_is_reported():
    drive = Drive(6, nodes=800, every=10)
    drive.measured[40:50] += (25.0, -12.0)
    found = fuse(odometry_of(drive), {"gps": gps_of(drive)})
    (shift,) = found.shifts
    assert (shift.source, shift.fixes) == ("gps", 10)
    assert (shift.begin_s, shift.end_s) == (BEGUN_S + 200.0, BEGUN_S + 245.0)
    assert (shift.east_m, shift.north_m) == pytest.approx((25.0, -12.0), abs=3.0)
    assert np.flatnonzero(found.gating["gps"].gated).tolist() == list(range(40, 50))


def test_fixes_between_those_of_the_sample_are_left_out_with_them(monkeypatch):
    monkeypatch.setattr(fusion, "MOST_EXPLAINED", 40)
    drive = Drive(6, nodes=800, every=5)
    drive.measured[80:104] += (40.0, -30.0)
    found = fuse(odometry_of(drive), {"gps": gps_of(drive)})
    assert found.gating["gps"].gated[84:100].all()
    assert found.gating["gps"].gated.sum() <= 24
    assert error_m(found, drive) < 2.0


def test_positions_are_as_sure_as_they_say():
    """Of white errors, as stated, though odometry is better than usual."""
    scores = []
    for seed in range(4):
        drive = fusion_outliers.simulate(seed, wrong=0.0)
        scores.append(fusion_outliers.consistency(fusion_outliers.ours(drive), drive)[0])
    assert 0.6 < np.mean(scores) < 1.6


@pytest.mark.parametrize("share", [0.0, 0.15])
def test_without_odometry_it_is_not_worse_than_lines_between_fixes(share):
    drive = fusion_outliers.without_odometry(share)(1)
    errors = [
        fusion_outliers.error(way(drive), drive) for way in (fusion_outliers.ours, fusion_outliers.lines)
    ]
    assert errors[0] < errors[1]


def test_a_receiver_that_starts_far_off_does_not_bend_the_way():
    drive = fusion_outliers.CASES["first 20 s 50 m off"](101)
    found = fusion_outliers.ours(drive)
    off = np.hypot(*(found.position - drive.truth[:, :2]).T)
    assert off[drive.times_s > 60].max() < 6
    assert off.max() < 20


def test_too_few_fixes_to_find_the_outlier():
    drive = Drive(4, nodes=120, every=20)
    assert fuse(odometry_of(drive), {"gps": gps_of(drive, stated_m=0.5)}).fit.stated == {"gps": 1.0}


def test_wheels_that_skid_are_noticed():
    drive = Drive(5, nodes=400)
    drive.moves[:, 2] *= 0.6  # the robot turns much more than its odometry says
    found = fuse(odometry_of(drive), {"visual": gps_of(drive)})
    assert found.fit.odometry > 1
    assert error_m(found, drive) < 1.5


def test_without_odometry_its_errors_are_the_usual_ones():
    assert fuse(None, {"gps": gps_of(Drive(5))}).fit.odometry == 1.0


def test_a_fusion_is_cancelled_before_the_smoother(monkeypatch):
    def check(_):
        raise InterruptedError

    monkeypatch.setattr(fusion, "smooth", None)
    drive = Drive(5)
    with pytest.raises(InterruptedError):
        fuse(odometry_of(drive), {"gps": gps_of(drive)}, check=check)


def test_fixes_without_covariance_and_impossible_ones_get_the_usual_one():
    drive = Drive(6, sigma_m=5.0, every=10)
    poses = gps_of(drive)
    poses.covariance_m2[:] = np.nan
    poses.covariance_m2[::2] = (1.0, 1.0, 3.0)
    usual = fuse(odometry_of(drive), {"gps": poses})
    result = fuse(odometry_of(drive), {"gps": gps_of(drive)})
    assert usual.poses.latlon == pytest.approx(result.poses.latlon, abs=1e-12)


def test_many_correlated_fixes_of_one_receiver_count_as_few():
    """Their common error does not average out."""
    drive = Drive(7, nodes=600, every=1)
    rng, kept, off = np.random.default_rng(7), np.exp(-0.5 / 20.0), np.zeros((600, 2))
    for i in range(600):
        off[i] = kept * off[i - 1] + rng.normal(0, 2.0 * (1 - kept**2) ** 0.5, 2)
    drive.measured = drive.truth + off
    found = fuse(odometry_of(drive), {"gps": gps_of(drive)})
    assert [one.correlated_s for one in found.fit.sources] == [20.0]
    few = fuse(odometry_of(drive), {"gps": gps_of(drive).take(slice(0, None, 40))})
    assert found.poses.covariance_m2[300, 0] > 0.25 * few.poses.covariance_m2[300, 0]


def test_from_piece_to_piece_nobody_travelled():
    drive = Drive(8, nodes=400)
    drive.measured[drive.node >= 200] += (500, 0)
    found = fuse(odometry_of(drive), {"visual": gps_of(drive)})
    assert found.begins_s == (BEGUN_S, BEGUN_S + 100.0)
    assert found.poses.travelled_m[-1] == pytest.approx(200, rel=0.2)


def test_heights_are_those_of_the_fixes_and_covariances_come_along():
    drive = Drive(9)
    found = fuse(odometry_of(drive), {"visual": gps_of(drive)})
    assert found.poses.height_m[[0, -1]] == pytest.approx([300, 320], abs=0.5)
    assert (found.poses.covariance_m2[:, :2] > 0).all()
    assert (found.poses.covariance_m2[:, :2] < 4.0 * 9).all()


def test_without_odometry_a_heading_needs_a_movement():
    drive = Drive(10)
    drive.measured[:] = drive.measured[0]
    still = fuse(None, {"gps": gps_of(drive)})
    assert np.isnan(still.poses.heading_deg).mean() > 0.9
    assert np.isnan(still.poses.height_m).sum() == 0


def test_odometry_that_was_reset_on_the_way():
    drive = Drive(11)
    result = odometry_of(drive)
    result.latlon[120:] += 0.01  # a kilometre, in half a second
    assert error_m(fuse(result, {"visual": gps_of(drive)}), drive) < 1.0


def test_nothing_to_put_together():
    drive = Drive(0)
    none = make_poses([], np.empty((0, 2)))
    found = fuse(odometry_of(drive), {"gps": none})
    assert not found
    assert "no fix" in found.reason


def test_one_fix_puts_odometry_where_it_is():
    drive = Drive(1)
    drive.heading[0] = 0.0
    one = gps_of(drive).take(slice(0, 1))
    found = fuse(odometry_of(drive), {"visual": one})
    assert len(found.poses) == drive.nodes
    assert FRAME.enu_from_latlon(found.poses.latlon[:1])[0] == pytest.approx(drive.measured[0], abs=0.01)
    assert found.poses.covariance_m2[-1, 0] > 100 * found.poses.covariance_m2[0, 0] ** 0.5


def test_a_long_track_is_thinned_and_keeps_its_movement(monkeypatch):
    monkeypatch.setattr(fusion, "MOST_POSES", 40)
    drive = Drive(12)
    found = fuse(odometry_of(drive), {"visual": gps_of(drive)})
    assert len(found.poses) <= 80
    assert error_m(found, drive) < 1.2


def test_one_pose_of_odometry_is_none():
    """Then there are poses between the fixes, as without odometry."""
    drive = Drive(1)
    found = fuse(odometry_of(drive).take(slice(0, 1)), {"visual": gps_of(drive)})
    assert np.isin(drive.steps.times_s[drive.node] + BEGUN_S, found.poses.times_s).all()
    between = (len(drive.node) - 1) * fusion.POSES_BETWEEN
    assert len(found.poses) == len(drive.node) + between
    assert found.fit.odometry == 1.0
