import math

import numpy as np
import pytest

from webapp.core.localize.resection import Bearings, resect

RADIUS = 50.0


def seen_from(position, heading, photos, *, noise=0.0, parallax_deg=6.0, seed=0):
    """Return exact or noisy bearings to photos at known positions, as from relative poses."""
    rng = np.random.default_rng(seed)
    to_photo = photos - position
    azimuth = np.arctan2(to_photo[:, 0], -to_photo[:, 1])
    bearing = azimuth - heading + rng.normal(0.0, noise, len(photos))
    return Bearings(
        position=photos.astype(float),
        bearing=bearing,
        parallax=np.full(len(photos), math.radians(parallax_deg)),
        weight=np.ones(len(photos)),
    )


def photos_around(centre, count=8, seed=1):
    return np.asarray(centre) + np.random.default_rng(seed).uniform(-60, 60, (count, 2))


@pytest.mark.parametrize("heading_deg", [0.0, 73.0, 200.0, 359.0])
def test_exact_bearings_give_position_and_heading(heading_deg):
    truth = np.array([512.0, 301.0])
    photos = photos_around(truth)
    everywhere = np.stack(np.meshgrid(np.arange(350, 700, 20), np.arange(150, 450, 20)), -1).reshape(-1, 2)
    fix = resect(
        seen_from(truth, math.radians(heading_deg), photos), everywhere, place_radius_px=RADIUS, most=3
    )[0]
    assert math.dist((fix.x, fix.y), truth) < 0.15 * RADIUS
    assert abs(math.remainder(fix.heading - math.radians(heading_deg), 2 * math.pi)) < math.radians(8)
    assert fix.score > 0.5 * len(photos) * math.exp(-0.5)


def test_wrong_bearings_are_outvoted():
    truth = np.array([512.0, 301.0])
    seen = seen_from(truth, 1.0, photos_around(truth, 9), noise=0.05)
    seen.bearing[:3] += np.array([1.9, -2.4, 2.9])
    fix = resect(seen, seen.position, place_radius_px=RADIUS, most=1)[0]
    assert math.dist((fix.x, fix.y), truth) < 0.5 * RADIUS
    assert fix.agreement[3:].mean() > 0.8
    assert fix.agreement[:3].max() < 0.3


def test_two_separate_solutions_stay_two():
    one, two = np.array([200.0, 200.0]), np.array([800.0, 300.0])
    a = seen_from(one, 0.3, photos_around(one, 6, seed=2))
    b = seen_from(two, 2.0, photos_around(two, 4, seed=3))
    both = Bearings(*(np.concatenate([getattr(a, f), getattr(b, f)]) for f in Bearings.__slots__))
    fixes = resect(both, both.position, place_radius_px=RADIUS, most=4)
    assert math.dist((fixes[0].x, fixes[0].y), one) < RADIUS
    assert min(math.dist((f.x, f.y), two) for f in fixes[1:]) < RADIUS
    assert fixes[0].score > fixes[1].score
    apart = [math.dist((f.x, f.y), (g.x, g.y)) for f in fixes for g in fixes if f is not g]
    assert min(apart) > 2.0 * RADIUS


def test_low_parallax_only_says_near():
    truth = np.array([400.0, 400.0])
    photos = np.array([[410.0, 395.0], [395.0, 410.0], [405.0, 402.0]])
    seen = seen_from(truth, 0.0, photos, parallax_deg=0.01)
    seen.bearing[:] = [0.0, 2.0, -2.0]  # noise, as without a baseline
    fix = resect(seen, photos, place_radius_px=RADIUS, most=1)[0]
    assert math.dist((fix.x, fix.y), photos.mean(0)) < 0.5 * RADIUS


def test_more_noise_means_more_spread():
    truth = np.array([512.0, 301.0])
    photos = photos_around(truth)
    grid = np.stack(np.meshgrid(np.arange(350, 700, 20), np.arange(150, 450, 20)), -1).reshape(-1, 2)
    sharp, vague = (
        np.mean(
            [
                resect(seen_from(truth, 0.5, photos, noise=n, seed=s), grid, place_radius_px=RADIUS, most=1)[
                    0
                ].sigma_px
                for s in range(5)
            ]
        )
        for n in (0.0, 0.6)
    )
    assert sharp < vague


def test_no_bearings_no_fix():
    empty = Bearings(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0))
    assert resect(empty, np.zeros((1, 2)), place_radius_px=RADIUS, most=3) == []
