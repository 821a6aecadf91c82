"""Submodels with ground truth."""

import numpy as np

from webapp.core.geometry import so3
from webapp.core.landmarks.placing import KnownPositions
from webapp.core.landmarks.submodels import Submodel


def random_rotation(rng):
    return so3.retract(np.eye(3)[None], rng.normal(0.0, 2.0, (1, 3)))[0]


def level_cameras(headings, *, tilt=0.0, rng=None):
    """Return the rotations from the world (x east, y down, z north) to level cameras; headings in radians."""
    rotation = []
    for heading in headings:
        sine, cosine = np.sin(heading), np.cos(heading)
        rotation.append([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])
    rotation = np.array(rotation)
    if tilt:
        rotation = so3.retract(rotation, rng.normal(0.0, tilt, (len(rotation), 3)))
    return rotation


def submodel_of(at, headings, *, rng, tilt=0.0, heights=0.0):
    """Return a submodel, in its own frame, whose cameras are at map pixels `at` (complex)."""
    world = np.stack([at.real, rng.normal(0.0, heights, len(at)) if heights else 0.0 * at.real, -at.imag], 1)
    turn, scale, shift = random_rotation(rng), 0.037, rng.normal(0.0, 5.0, 3)
    rotation = level_cameras(headings, tilt=tilt, rng=rng) @ turn.T
    return Submodel(np.arange(len(at)), scale * world @ turn.T + shift, rotation)


def known_at(at, which, *, sigma_px=1.0):
    known = np.full(len(at), complex(np.nan, np.nan))
    known[which] = at[which]
    return KnownPositions(known, np.full(len(at), sigma_px), np.zeros(len(at), np.bool_))
