"""Poses of a camera that sees printed tags of known size at known positions.

A small bundle adjustment with one camera. Its measurements are the corners of the tags; what is known of
the tags (position, height, upright on a wall or level on the floor, where they face) and of the focal length
are priors with standard deviations, so that all of it enters the covariance. A square that is seen small or
at a distance has two poses that fit about as well (T. Collins, A. Bartoli, "Infinitesimal plane-based pose
estimation", 2014): both are starts, and both are returned unless the data exclude one.

Frame: metres, x right and y down on the map, z down.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geometry import so3
from webapp.core.geometry.estimate import NoPose
from webapp.core.landmarks.absolute_pose import Lens
from webapp.core.mapmodel.control_points import TagMount

Array = NDArray[np.float64]

_CORNER_PX = 0.2
"""Standard deviation of a corner along each axis, in photos with some blur and noise."""

_TILT_DEG, _HEADING_DEG = 2.0, 3.0
"""Standard deviations of how level or upright a tag is, and of a heading that is stated."""

_ANY = 1e3
"""Standard deviation of what is not known: metres, radians."""

_ROLL_DEG = 10.0
"""Typical roll of a camera; larger ones are possible, at most a few times less probable."""

_STARTS_FROM = 3
"""Number of tags, the largest ones, from whose poses the adjustment starts."""

_ROUNDS, _SETTLED = 40, 1e-5
_STEP = 1e-6
_APART_M = 0.02
"""Poses that are nearer to each other than this, or than the radius of one, are the same."""

_RADIUS_OVER_SIGMAS = 1.07
"""68 % radius over the root of the sum of both variances."""

_LEAST_WEIGHT = 0.02
_MOST_MISFIT = 16.0
"""Sum of squares per degree of freedom above which tags contradict each other."""

_BASELINE_M = 0.05
"""Least distance of two tags from which the direction between them is taken."""


@dataclass(frozen=True, slots=True, eq=False)
class PlacedTag:
    """A tag on the map, as a photo shows it."""

    name: str
    corners: Array  # (4, 2) float64. See `SeenTag`.
    size_m: float
    # `at`, `sigma_m`: (3,) float64. Position of its middle, and standard deviations along the axes.
    at: Array
    sigma_m: Array
    mount: TagMount
    heading_rad: float | None  # Clockwise from the top of the map

    @property
    def shape(self) -> Array:
        """Its corners (4, 3) in its own frame: x right, y down, z away from the viewer."""
        half = self.size_m / 2.0
        return half * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class TagPose:
    """One pose of the camera."""

    centre: Array  # (3,) float64
    rotation: Array  # (3, 3) float64. Camera from the frame of the map.
    # (6, 6) float64. Of the centre, and of a small rotation in the camera's own frame, radians.
    covariance: Array
    weight: float  # Probability among the poses that are returned together
    tags: tuple[str, ...]  # Names of the tags that agree on it

    @property
    def radius_m(self) -> float:
        """68 % radius on the map."""
        return _RADIUS_OVER_SIGMAS * math.sqrt(float(self.covariance[0, 0] + self.covariance[1, 1]))


@dataclass(frozen=True, slots=True, eq=False)
class SolvedByTags:
    """Poses, the most probable first, and the names of tags that contradict the others."""

    poses: tuple[TagPose, ...]
    contradicting: tuple[str, ...] = ()


@dataclass(slots=True, eq=False)
class _State:
    """What is estimated, with n tags; or several states at once."""

    centre: Array  # (..., 3)
    rotation: Array  # (..., 3, 3)
    log_focal: Array  # (...,). Logarithm of the focal length over the given one.
    at: Array  # (..., n, 3)
    turned: Array  # (..., n, 3, 3). World from tag.

    def moved(self, step: Array) -> _State:
        """Add steps (..., 7 + 6 n)."""
        own = step[..., 7:].reshape(*step.shape[:-1], -1, 6)
        return _State(
            self.centre + step[..., :3],
            so3.exp(step[..., 3:6]) @ self.rotation,
            self.log_focal + step[..., 6],
            self.at + own[..., :3],
            self.turned @ so3.exp(own[..., 3:]),
        )


def solve_by_tags(tags: Sequence[PlacedTag], *, lens: Lens) -> SolvedByTags | NoPose:
    """Estimate the poses of a camera from the tags that it sees.

    Args:
        tags: At least one; each is at one place.
    """
    if len(tags) == 1 and tags[0].heading_rad is None:
        return NoPose("one tag whose heading is not known: give its heading, or show a second tag")
    poses, misfit = _poses(tags, lens=lens)
    if misfit <= _MOST_MISFIT:
        return SolvedByTags(poses)
    if len(tags) == 2:
        alone = [pose for tag in tags if tag.heading_rad is not None for pose in _poses([tag], lens=lens)[0]]
        if not alone:
            return NoPose(f"the tags {tags[0].name} and {tags[1].name} contradict each other")
        shared = sum(pose.weight for pose in alone)
        evened = (_weighed(pose, pose.weight / shared) for pose in alone)
        names = tuple(tag.name for tag in tags)
        return SolvedByTags(tuple(sorted(evened, key=lambda pose: -pose.weight)), names)
    without = [(_poses([*tags[:n], *tags[n + 1 :]], lens=lens)[1], n) for n in range(len(tags))]
    worst = min(without)[1]
    rest = solve_by_tags([*tags[:worst], *tags[worst + 1 :]], lens=lens)
    if isinstance(rest, NoPose):
        return rest
    return SolvedByTags(rest.poses, (tags[worst].name, *rest.contradicting))


def distance_to(tag: PlacedTag, *, lens: Lens) -> float:
    """Return the horizontal distance of the camera from a tag, metres."""
    apart = [mount_rotation(tag.mount, 0.0) @ (turn.T @ shift) for turn, shift in _planar_poses(tag, lens)]
    return float(np.mean([math.hypot(one[0], one[1]) for one in apart]))


def mount_rotation(mount: TagMount, heading_rad: float) -> Array:
    """Return the rotation (3, 3) to the world from a tag that is mounted exactly upright, or level."""
    there = np.array([math.sin(heading_rad), -math.cos(heading_rad), 0.0])
    down = np.array([0.0, 0.0, 1.0])
    y, z = (down, -there) if mount == "wall" else (-there, down)
    return np.column_stack([np.cross(y, z), y, z])


def _weighed(pose: TagPose, weight: float) -> TagPose:
    return TagPose(pose.centre, pose.rotation, pose.covariance, weight, pose.tags)


def _poses(tags: Sequence[PlacedTag], *, lens: Lens) -> tuple[tuple[TagPose, ...], float]:
    """Return the different poses that fit, the best first, and the misfit of the best one."""
    problem = _Problem(tags, lens)
    found = sorted((problem.solve(start) for start in _starts(tags, lens)), key=lambda one: one[1])
    if not found:
        return (), math.inf
    best = found[0][1]
    misfit = best / problem.freedom
    names, poses = tuple(tag.name for tag in tags), list[TagPose]()
    for state, cost in found:
        weight = math.exp(-0.5 * (cost - best) / max(1.0, misfit))
        covariance = problem.covariance(state, scale=max(1.0, misfit))
        if weight < _LEAST_WEIGHT or covariance is None:
            continue
        if not any(_is_same_place(state, pose) for pose in poses):
            poses.append(TagPose(state.centre, state.rotation, covariance, weight, names))
    total = sum(pose.weight for pose in poses)
    return tuple(_weighed(pose, pose.weight / total) for pose in poses), misfit if poses else math.inf


def _is_same_place(state: _State, pose: TagPose) -> bool:
    return math.dist(state.centre[:2], pose.centre[:2]) < max(pose.radius_m, _APART_M)


def _planar_poses(tag: PlacedTag, lens: Lens) -> list[tuple[Array, Array]]:
    """Return one or two poses of a tag: rotation (3, 3) and translation (3,), camera from tag."""
    focal = lens.focal_px
    matrix = np.array(
        [[focal, 0.0, (lens.width - 1) / 2.0], [0.0, focal, (lens.height - 1) / 2.0], [0.0, 0.0, 1.0]]
    )
    _, turns, shifts, _ = cv2.solvePnPGeneric(tag.shape, tag.corners, matrix, None, flags=cv2.SOLVEPNP_IPPE)
    pairs = zip(turns, shifts, strict=True)
    found = [(so3.exp(np.asarray(turn).ravel()), np.asarray(shift).ravel()) for turn, shift in pairs]
    return [(turn, shift) for turn, shift in found if np.isfinite(shift).all() and shift[2] > 0.0]


def _starts(tags: Sequence[PlacedTag], lens: Lens) -> Iterator[_State]:
    """Yield poses by each of the largest tags, with its heading or the direction to each other tag."""
    planar = [_planar_poses(tag, lens) for tag in tags]
    for number, tag in enumerate(tags[:_STARTS_FROM]):
        for turn, shift in planar[number]:
            level = turn @ mount_rotation(tag.mount, tag.heading_rad or 0.0).T
            if tag.heading_rad is not None:
                yield _start(tags, planar, rotation=level, centre=tag.at - level.T @ shift)
                continue
            for other, poses in zip(tags, planar, strict=True):
                for _, there in poses[:1]:
                    seen, known = level.T @ (there - shift), other.at - tag.at
                    if min(math.hypot(*seen[:2]), math.hypot(*known[:2])) < _BASELINE_M:
                        continue
                    yaw = math.atan2(known[1], known[0]) - math.atan2(seen[1], seen[0])
                    rotation = level @ so3.exp(np.array([0.0, 0.0, -yaw]))
                    yield _start(tags, planar, rotation=rotation, centre=tag.at - rotation.T @ shift)


def _start(
    tags: Sequence[PlacedTag],
    planar: Sequence[Sequence[tuple[Array, Array]]],
    *,
    rotation: Array,
    centre: Array,
) -> _State:
    """Complete a camera with the headings of tags that do not state theirs."""
    turned = []
    for tag, poses in zip(tags, planar, strict=True):
        heading = tag.heading_rad
        if heading is None:
            # of its two poses take the one that is mounted more exactly
            seen = [rotation.T @ turn for turn, _ in poses]
            fits = [mount_rotation(tag.mount, _heading_of(one, tag.mount)) for one in seen] or [np.eye(3)]
            errors = [float(np.abs(fit - one).sum()) for fit, one in zip(fits, seen, strict=False)]
            turned.append(fits[int(np.argmin(errors))] if errors else mount_rotation(tag.mount, 0.0))
        else:
            turned.append(mount_rotation(tag.mount, heading))
    return _State(centre, rotation, np.zeros(()), np.array([tag.at for tag in tags]), np.array(turned))


def _heading_of(turned: Array, mount: TagMount) -> float:
    there = -turned[:, 2] if mount == "wall" else -turned[:, 1]
    return math.atan2(there[0], -there[1])


class _Problem:
    """Least squares over the state, with priors."""

    def __init__(self, tags: Sequence[PlacedTag], lens: Lens) -> None:
        self._tags, self._lens = tags, lens
        self._focal_sigma = max(lens.focal_sigma, 1e-4)
        self._shape = np.array([tag.shape for tag in tags])
        self._corners = np.array([tag.corners for tag in tags])
        self._at = np.array([tag.at for tag in tags])
        self._at_sigma = np.array([tag.sigma_m for tag in tags])
        mounted = [mount_rotation(tag.mount, tag.heading_rad or 0.0) for tag in tags]
        self._mounted = np.array(mounted)
        tilt = math.radians(_TILT_DEG)
        headings = [_ANY if tag.heading_rad is None else math.radians(_HEADING_DEG) for tag in tags]
        # about the tag's own x, y and z
        self._turn_sigma = np.array(
            [
                [tilt, one, tilt] if tag.mount == "wall" else [tilt, tilt, one]
                for tag, one in zip(tags, headings, strict=True)
            ]
        )
        unknown = int((self._turn_sigma >= _ANY).sum() + (self._at_sigma >= _ANY).sum())
        self.freedom = max(8 * len(tags) - 6 - unknown, 1)

    def solve(self, state: _State) -> tuple[_State, float]:
        """Minimise by Levenberg-Marquardt; return the state and its sum of squares."""
        damping, off = 1e-3, self._residuals(state)
        cost = float(off @ off)
        for _ in range(_ROUNDS):
            jacobian = self._jacobian(state, off)
            normal, gradient = jacobian.T @ jacobian, jacobian.T @ off
            damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
            step: Array = np.asarray(np.linalg.solve(damped, -gradient), np.float64)
            tried = state.moved(step)
            new = self._residuals(tried)
            new_cost = float(new @ new)
            if not new_cost < cost:
                damping *= 10.0
                if damping > 1e8:
                    break
                continue
            settled = cost - new_cost < _SETTLED * (1.0 + cost)
            state, off, cost, damping = tried, new, new_cost, max(damping / 10.0, 1e-9)
            if settled:
                break
        return state, cost

    def covariance(self, state: _State, *, scale: float) -> Array | None:
        """Return the covariance (6, 6) of the camera; None if it is not determined."""
        jacobian = self._jacobian(state, self._residuals(state))
        size = np.sqrt((jacobian**2).sum(0)) + 1e-12
        normal = (jacobian / size).T @ (jacobian / size)
        if not np.isfinite(normal).all() or np.linalg.cond(normal) > 1e14:
            return None
        whole = scale * np.linalg.inv(normal) / np.outer(size, size)
        return np.asarray(whole[:6, :6])

    def _residuals(self, state: _State) -> Array:
        """Return corners, then priors, all over their standard deviations: (..., 14 n + 2)."""
        world = state.at[..., None, :] + self._shape @ np.swapaxes(state.turned, -1, -2)
        own = (world - state.centre[..., None, None, :]) @ np.swapaxes(state.rotation, -1, -2)[
            ..., None, :, :
        ]
        depth = np.maximum(own[..., 2:], 1e-3)  # behind the camera: a large, finite error
        focal = self._lens.focal_px * np.exp(np.clip(state.log_focal, -3.0, 3.0))[..., None, None, None]
        middle = np.array([(self._lens.width - 1) / 2.0, (self._lens.height - 1) / 2.0])
        corners = (focal * own[..., :2] / depth + middle - self._corners) / _CORNER_PX
        turn = so3.log(np.swapaxes(self._mounted, 1, 2) @ state.turned) / self._turn_sigma
        at = (state.at - self._at) / self._at_sigma
        right = state.rotation[..., 0, :]
        roll = np.degrees(np.arctan2(right[..., 2], np.hypot(right[..., 0], right[..., 1])))
        heavy: Array = np.copysign(np.sqrt(np.log1p((roll / _ROLL_DEG) ** 2)), roll)
        priors = np.stack([state.log_focal / self._focal_sigma, heavy], -1)
        parts = [part.reshape(*roll.shape, -1) for part in (corners, turn, at, priors)]
        return np.concatenate(parts, -1)

    def _jacobian(self, state: _State, off: Array) -> Array:
        steps: Array = np.diag(np.full(7 + 6 * len(self._tags), _STEP))
        moved = self._residuals(state.moved(steps))
        return np.asarray((moved - off).T / _STEP)
