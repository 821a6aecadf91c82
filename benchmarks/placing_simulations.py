"""Measures how photos are placed from a few known positions, on simulated models with ground truth.

    python -m benchmarks.placing_simulations

- *pitch*: a grid flown with constant yaw, at several pitches of the camera, with six clicks; next to it the
  same with the vertical of level cameras, which was the only one before.
- *wrong click*: a walk of 60 photos with one of its clicks 20 m off; how often just this one is named, how
  often another one is, also without a wrong click, and how far off the other photos are.

Units are metres. Prints one JSON object per line.
"""

from __future__ import annotations

import json

import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.landmarks.placing import AlignedSubmodel, KnownPositions, align_submodel
from webapp.core.landmarks.submodels import Submodel, view_by_level_cameras

Array = NDArray[np.float64]
Points = NDArray[np.complex128]

RUNS = 30
PX_PER_M = 10.0
CLICK_M, OFF_M = 0.5, 20.0
"""Standard deviation of clicks along each axis, and how far off the wrong one is."""


def model_of(
    at: Points, *, height: Array, heading: Array, pitch_deg: float, rng: np.random.Generator
) -> Submodel:
    """Make a model, in a frame of its own, of cameras at map pixels `at` that pitch up by `pitch_deg`.

    Orientations are off by 0.5 degrees, centres by 1 cm.
    """
    sine, cosine = np.sin(heading), np.cos(heading)
    down, up = np.cos(np.radians(pitch_deg)), np.sin(np.radians(pitch_deg))
    zero = np.zeros(len(at))
    # in a world of x to the right, y down the image and z into the ground
    right = np.stack([cosine, sine, zero], 1)
    front = np.stack([sine * down, -cosine * down, zero - up], 1)
    rotation = np.stack([right, np.cross(front, right), front], 1)
    rotation = so3.retract(rotation, rng.normal(0.0, np.radians(0.5), (len(at), 3)))
    centre = np.column_stack([at.real, at.imag, -height * PX_PER_M])
    centre += rng.normal(0.0, 0.01 * PX_PER_M, centre.shape)
    turn = so3.retract(np.eye(3)[None], rng.normal(0.0, 2.0, (1, 3)))[0]
    return Submodel(np.arange(len(at)), 0.037 * centre @ turn.T + rng.normal(0.0, 5.0, 3), rotation @ turn.T)


def clicks_on(at: Points, which: NDArray[np.int64], *, noise_m: float, rng: np.random.Generator) -> Points:
    """Return positions (n,) with the clicks of some photos, NaN for the others."""
    known = np.full(len(at), complex(np.nan, np.nan))
    noise = rng.normal(0.0, noise_m * PX_PER_M, (2, len(which)))
    known[which] = at[which] + noise[0] + 1j * noise[1]
    return known


def known_at(at: Points, *, sigma_m: float) -> KnownPositions:
    """Return known positions with one accuracy."""
    sigma = np.full(len(at), max(sigma_m * PX_PER_M, 1.0))
    return KnownPositions(at, sigma, np.zeros(len(at), np.bool_))


def grid_flight() -> tuple[Points, Array]:
    """Return map pixels and headings of 36 photos, 12 m apart in rows that are 15 m apart."""
    x, y = np.meshgrid(12.0 * np.arange(6), 15.0 * np.arange(6))
    return PX_PER_M * (x + 1j * y).ravel(), np.full(36, 0.6)


def walk() -> tuple[Points, Array]:
    """Return map pixels and headings of 60 photos, 2 m apart on a path that turns."""
    heading = np.cumsum(0.05 * np.sin(np.arange(60) / 7.0))
    step = 2.0 * PX_PER_M * (np.sin(heading) - 1j * np.cos(heading))
    return np.cumsum(step), heading


def errors(aligned: object, at: Points, known: Points) -> Array:
    """Return the errors of the photos that were not clicked; infinite if the model was not placed."""
    rest = ~np.isfinite(known)
    if not isinstance(aligned, AlignedSubmodel):
        return np.full(rest.sum(), np.inf)
    return np.asarray(np.abs(aligned.at - at)[rest] / PX_PER_M)


def at_pitch(pitch_deg: float) -> dict[str, object]:
    """Compare the vertical that is chosen with that of level cameras, six clicks each."""
    at, heading = grid_flight()
    chosen, level, inside, turned = list[Array](), list[Array](), list[float](), list[float]()
    for run in range(RUNS):
        rng = np.random.default_rng([50, run])
        height = rng.normal(40.0, 0.3, len(at))
        model = model_of(at, height=height, heading=heading, pitch_deg=pitch_deg, rng=rng)
        which = rng.choice(len(at), 6, replace=False)
        clicked = clicks_on(at, which, noise_m=0.2, rng=rng)
        known = known_at(clicked, sigma_m=0.2)
        aligned = align_submodel(model, known)
        chosen.append(errors(aligned, at, clicked))
        level.append(errors(align_submodel(model, known, view=view_by_level_cameras(model)), at, clicked))
        if isinstance(aligned, AlignedSubmodel):
            rest = ~np.isfinite(clicked)
            inside.append(float(np.mean(chosen[-1] <= aligned.radius_px[rest] / PX_PER_M)))
            off = (aligned.angle_deg - np.degrees(heading) + 180.0) % 360.0 - 180.0
            turned.append(float(np.median(np.abs(off))))
    return {
        "pitch_deg": pitch_deg,
        "median_m": _round(np.median(chosen)),
        "largest_m": _round(np.max(chosen)),
        "within_radius": _round(np.mean(inside)),
        "heading_off_deg": _round(np.median(turned)),
        "median_m_by_level_cameras": _round(np.median(level)),
    }


def with_wrong_click(clicks: int) -> dict[str, object]:
    """Put one of some clicks of a walk 20 m off; the same clicks without it are the other case."""
    at, heading = walk()
    named, others, of_right, off = 0, 0, 0, list[float]()
    for run in range(RUNS):
        rng = np.random.default_rng([51, clicks, run])
        model = model_of(at, height=np.zeros(len(at)), heading=heading, pitch_deg=0.0, rng=rng)
        jitter = rng.integers(-2, 3, clicks)
        which = np.clip(np.linspace(0, len(at) - 1, clicks).round().astype(np.int64) + jitter, 0, len(at) - 1)
        which = np.unique(which)
        right = clicks_on(at, which, noise_m=CLICK_M, rng=rng)
        wrong, odd = right.copy(), int(rng.choice(which))
        wrong[odd] += OFF_M * PX_PER_M * np.exp(2j * np.pi * rng.random())
        aligned = align_submodel(model, known_at(wrong, sigma_m=CLICK_M))
        found = _contradicting(aligned)
        named += found == {odd}
        others += bool(found - {odd})
        of_right += bool(_contradicting(align_submodel(model, known_at(right, sigma_m=CLICK_M))))
        off.append(float(np.median(errors(aligned, at, wrong))))
    return {
        "clicks": clicks,
        "runs": RUNS,
        "named": named,
        "another_named": others,
        "named_of_right_ones": of_right,
        "median_m": _round(np.median(off)),
    }


def _contradicting(aligned: object) -> set[int]:
    if not isinstance(aligned, AlignedSubmodel):
        return set()
    return set(np.flatnonzero(aligned.contradicting).tolist())


def _round(value: np.floating | float) -> float:
    return round(float(value), 2)


def main() -> None:
    """Run as a command."""
    for pitch_deg in (0.0, -30.0, -45.0, -60.0, -90.0):
        print(json.dumps(at_pitch(pitch_deg)))
    for clicks in (4, 6, 8, 12):
        print(json.dumps(with_wrong_click(clicks)))


if __name__ == "__main__":
    main()
