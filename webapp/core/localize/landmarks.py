"""Method `landmarks`: the query's camera is solved from points of a reconstruction.

1. Retrieve: as in `verified`, the map's photos with most votes are the shortlist.
2. Match: shortlisted photos that see the same points form groups; the query is matched to a group's points.
3. Pose: P3P in a RANSAC gives the camera in the reconstruction; the placed photos around it determine
   its pose on the map (`landmarks.placing`).
4. Probability: as in `verified`. If too few points agree, there is no place.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.relative_pose import (
    CHANCE_INLIERS,
    INLIER_SCALE,
    Camera,
    RelativePose,
    beyond_chance,
)
from webapp.core.hypotheses.calibration import DEFAULT, weigh
from webapp.core.hypotheses.model import Answer, CameraPose, FieldOfView
from webapp.core.landmarks.absolute_pose import (
    AbsolutePose,
    Lens,
    SolvedCamera,
    angle_jacobian,
    euler_angles,
    solve_camera,
)
from webapp.core.landmarks.cloud import AlignedCloud, PhotoGroup
from webapp.core.landmarks.placing import AlignedSubmodel, MapPoint
from webapp.core.localize.evidence import Spots, evidence_vectors
from webapp.core.localize.places import PlaceCandidate, VerifiedPhoto, voters_of
from webapp.core.localize.verified import PlaceSearch
from webapp.core.localize.vote import match_statistics
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.retrieve import ShortlistedPhoto, retrieve

Array = NDArray[np.float64]

_GROUPS = 4
"""Number of groups of photos that are tried, those with the best photos."""

_CELLS = 20
"""Cells along the longer side of a query in which landmarks that agree count once."""

_GUESSES = (0.7, 1.0, 1.4)
"""Focal lengths that are tried, over a guessed one."""

_FOCAL_SIGMA_OF_GROUP = 0.01
"""Standard deviation of the focal lengths of photos of one size, as a fraction of their median."""

_RADIUS_OVER_SIGMA = 1.515
"""68 % radius of an isotropic Gaussian error in the plane, over its standard deviation along an axis."""


@dataclass(frozen=True, slots=True, eq=False)
class _Query:
    features: Features
    fov: FieldOfView
    votes: Array


def find_by_landmarks(
    indexed: IndexedMap,
    query: Features,
    *,
    fov: FieldOfView,
    aligned: AlignedCloud,
    hide: Collection[int] = (),
) -> PlaceSearch:
    """Find the places where a photo may have been taken, by the landmarks that it shows.

    Args:
        indexed: Indexed with the features of the cloud: SIFT.
        hide: Experience ids to leave out. Landmarks that fewer than two other photos see are left out, too;
            the positions of the remaining landmarks were estimated with the hidden photos.
    """
    clock = [time.perf_counter()]
    retrieved = retrieve(indexed, query, hide=hide)
    nearest, found, alike = retrieved.nearest, retrieved.found, retrieved.alike
    listed, further = retrieved.listed, retrieved.further
    clock.append(time.perf_counter())
    photos = np.array([one.photo for one in listed], np.int64)
    places = _places(indexed, _Query(query, fov, retrieved.votes), photos, aligned=aligned, hide=hide)
    clock.append(time.perf_counter())
    by_pose = [photo for place in places for photo in place.photos]
    named = {photo.matched.photo for photo in by_pose}
    by_votes = [VerifiedPhoto.by_votes(one) for one in [*listed, *further] if one.photo not in named]
    at = Spots(
        np.array([place.position for place in places], np.float64).reshape(-1, 2),
        np.array([place.area for place in places], np.int64),
        np.array([place.floor for place in places], np.int64),
    )
    voters = voters_of([*by_pose, *by_votes])
    score = [place.score for place in places]
    evidence = evidence_vectors(indexed, voters, at=at, score=score, least_trust=score, alike=alike)
    order = np.argsort(-weigh(evidence, DEFAULT), kind="stable")
    clock.append(time.perf_counter())
    distance = nearest.distance[:, 0][nearest.photo[:, 0] >= 0]
    reason = "too few matching landmarks" if len(query) else "no keypoints"
    stages = ("retrieve", "verify", "position")
    return PlaceSearch(
        [places[n] for n in order],
        evidence[order],
        Answer(
            hypotheses=(),
            off_map_probability=1.0,
            other_probability=0.0,
            no_pose=None if places else NoPose(reason),
            statistics=match_statistics(len(query), distance, left=int((found.photo[:, 0] >= 0).sum())),
            seconds={s: b - a for s, a, b in zip(stages, clock, clock[1:], strict=False)},
        ),
    )


def _places(
    indexed: IndexedMap,
    query: _Query,
    photos: NDArray[np.int64],
    *,
    aligned: AlignedCloud,
    hide: Collection[int],
) -> list[PlaceCandidate]:
    """Solve the camera for each group of photos; those with most landmarks first, no two at one place."""
    hidden = np.append(np.isin(indexed.ids, [*hide]), False)[aligned.map_photo]
    found = [
        place
        for group in aligned.groups(photos, visible=~hidden, most=_GROUPS)
        for place in [_place(indexed, query, group, aligned=aligned, hidden=hidden)]
        if place is not None
    ]
    found.sort(key=lambda place: -(place.camera.landmarks if place.camera else 0))
    places: list[PlaceCandidate] = []
    for place in found:
        radius = indexed.tuning.places.apart * indexed.place_radius_px
        apart = (
            place.floor != other.floor or math.dist(place.position, other.position) > radius
            for other in places
        )
        if all(apart):
            places.append(place)
    return places


def _place(
    indexed: IndexedMap,
    query: _Query,
    group: PhotoGroup,
    *,
    aligned: AlignedCloud,
    hidden: NDArray[np.bool_],
) -> PlaceCandidate | None:
    cloud = aligned.cloud
    number = int(cloud.submodel[cloud.seen_point[group.rows[0]]])
    on_map = aligned.aligned[number]
    if not isinstance(on_map, AlignedSubmodel):
        return None
    transform = on_map.transform.without(hidden[aligned.submodels[number].photo])
    if transform is None:
        return None
    lenses = _lenses(indexed, query, group, aligned=aligned)
    solved = solve_camera(query.features, cloud, rows=group.rows, lenses=lenses)
    pose = solved.pose
    if isinstance(pose, NoPose):
        return None
    at = transform.map_point(pose.centre)
    camera, heading = _on_map(pose, transform.frame, at)
    supporting = _supporting(query, group, solved, pose=pose, aligned=aligned)
    sigma_px = math.sqrt(camera.covariance[0, 0] + camera.covariance[1, 1])
    # reject positions that are less certain than the size of a place
    if not supporting or sigma_px > indexed.tuning.places.max_sigma * indexed.place_radius_px:
        return None
    position = MapPixel(at.at.real, at.at.imag)
    shown = query.features.xy[solved.query_row]
    alone = agreeing_photos(shown, pose.inlier, longer_px=max(query.features.photo_size))
    score = max(sum(photo.weight for photo in supporting), alone)
    # a group may span floors, e.g. across an atrium: use the floor of the photo with most shared landmarks
    floor = int(indexed.floor[supporting[0].matched.photo])
    return PlaceCandidate(
        "position", position, heading, sigma_px, supporting, score, position, camera=camera, floor=floor
    )


def agreeing_photos(xy: NDArray[np.float32], inlier: NDArray[np.bool_], *, longer_px: float) -> float:
    """Convert the landmarks that agree on a camera to the number of photos that would be as much evidence.

    A landmark is seen by several photos, so that few are left to each; together they are evidence all the
    same. Those in one cell of the picture count once, as a cluster of matches agrees with wrong cameras, too.

    Args:
        xy: (m, 2) float32. Where the query shows the matched landmarks, pixels.
        inlier: (m,) bool
    """
    if not inlier.any():
        return 0.0
    cells = len(np.unique(np.floor(xy[inlier] * (_CELLS / longer_px)), axis=0))
    return beyond_chance(float(inlier.mean())) * max(0.0, cells - CHANCE_INLIERS) / INLIER_SCALE


def _lenses(indexed: IndexedMap, query: _Query, group: PhotoGroup, *, aligned: AlignedCloud) -> list[Lens]:
    """List candidate lenses of the query: the given one, and the median of the group's photos of its size.

    The reconstruction has estimated theirs more accurately than EXIF. Around a guess there are several, since
    the refinement of the focal length only starts where enough landmarks agree.
    """
    size, fov = query.features.photo_size, query.fov
    focal_px, factors = Camera(*size, fov.degrees).focal_px, _GUESSES if fov.source == "guess" else (1.0,)
    stated = [Lens(*size, factor * focal_px, focal_sigma=fov.focal_sigma) for factor in factors]
    same = [n for n in group.photos if indexed.photo_size(int(aligned.map_photo[n])) == size]
    if not same:
        return stated
    theirs = aligned.cloud.focal_px[same], aligned.cloud.distortion[same]
    usual = Lens(*size, *(float(np.median(one)) for one in theirs))
    return [*stated, replace(usual, focal_sigma=_FOCAL_SIGMA_OF_GROUP)]


def _on_map(pose: AbsolutePose, frame: Array, at: MapPoint) -> tuple[CameraPose, float]:
    """Transform a camera from a submodel to the map; returns pose and heading, radians clockwise from up."""
    turn = np.array([[at.factor.real, -at.factor.imag, 0.0], [at.factor.imag, at.factor.real, 0.0]])
    scale = abs(at.factor)
    to_map = np.vstack([turn, [0.0, 0.0, -scale]]) @ frame
    level = np.vstack([turn / scale, [0.0, 0.0, 1.0]]) @ frame
    rotation = pose.rotation @ level.T
    jacobian = np.zeros((6, 6))
    jacobian[:3, :3] = to_map
    jacobian[3:, 3:] = np.degrees(angle_jacobian(rotation))
    covariance = jacobian @ pose.covariance @ jacobian.T
    laid_variance = (at.radius_px / _RADIUS_OVER_SIGMA) ** 2
    covariance[[0, 1, 2], [0, 1, 2]] += laid_variance
    heading, pitch, roll = euler_angles(rotation).tolist()
    found = CameraPose(
        at.height_px, math.degrees(pitch), math.degrees(roll), covariance, int(pose.inlier.sum())
    )
    return found, heading


def _supporting(
    query: _Query,
    group: PhotoGroup,
    solved: SolvedCamera,
    *,
    pose: AbsolutePose,
    aligned: AlignedCloud,
) -> list[VerifiedPhoto]:
    """List the photos that see inlier landmarks, with matches, in the form of verified photos."""
    cloud, row = aligned.cloud, solved.query_row
    point = cloud.seen_point[solved.seen]
    none = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0), (0.0, 0.0)
    verified = []
    for photo in group.photos:
        own = group.rows[group.photo_of_row == photo]
        _, match, theirs = np.intersect1d(point, cloud.seen_point[own], return_indices=True)
        inlier = pose.inlier[match]
        if not inlier.any():
            continue
        number, match_row, own = int(aligned.map_photo[photo]), row[match], own[theirs]
        xy = query.features.xy[match_row]
        votes = float(query.votes[number])
        listed = ShortlistedPhoto(number, votes, match_row, own, xy, cloud.seen_xy[own])
        relative = _relative_pose(pose, photo, inlier=inlier, aligned=aligned)
        verified.append(VerifiedPhoto(listed, relative, *none))
    return sorted(verified, key=lambda photo: (-photo.inliers, photo.matched.photo))


def _relative_pose(
    pose: AbsolutePose, photo: int, *, inlier: NDArray[np.bool_], aligned: AlignedCloud
) -> RelativePose:
    submodel = aligned.submodel_of(photo)
    row = int(np.flatnonzero(submodel.photo == photo)[0])
    rotation = submodel.rotation[row] @ pose.rotation.T
    apart = pose.centre - submodel.centre[row]
    translation = submodel.rotation[row] @ apart
    to_photo = -pose.rotation @ apart
    length = float(np.linalg.norm(apart)) or 1.0
    return RelativePose(
        bearing=math.atan2(to_photo[0], to_photo[2]),
        parallax=0.0,
        inlier=inlier,
        rotation=rotation,
        translation=translation / length,
    )
