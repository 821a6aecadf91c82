"""Aligns a submodel with the map by placed photos and control points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.control_points import KnownPoint, NotTriangulated, Triangulated, triangulate
from webapp.core.landmarks.placing import (
    AlignedSubmodel,
    KnownPositions,
    NotAligned,
    align_submodel,
    choose_view,
    outlying_positions,
)
from webapp.core.landmarks.radii import PlacedPhotos, radius_by_covariance
from webapp.core.landmarks.submodels import (
    PlanView,
    Points,
    Submodel,
    view_by_heights,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PointFit:
    """A control point on the map."""

    name: str
    at: complex  # Known position, map pixels
    predicted: complex  # Position predicted from the other known positions; NaN if there are too few
    contradicts: bool  # It was left out because the others agree on another position
    wrong: tuple[str, ...]  # Names of the photos whose clicks disagree
    photos: int  # Number of joined photos whose clicks agree
    # Standard deviation along each axis, map pixels, of its known position and its clicks together; NaN
    # where the submodel is not on the map.
    sigma_px: float
    # Of a check point: predicted minus known height, map pixels; NaN if it or all control points have none.
    height_off_px: float = math.nan


@dataclass(frozen=True, slots=True, eq=False)
class Georegistration:
    """A submodel on the map, or why it could not be aligned."""

    aligned: AlignedSubmodel | NotAligned
    points: tuple[PointFit, ...]  # Of the control points that were triangulated
    problems: tuple[NotTriangulated, ...]  # Control points that could not be triangulated, and why


def georegister(
    submodel: Submodel, known: KnownPositions, *, points: Sequence[KnownPoint]
) -> Georegistration:
    """Align a submodel with the map.

    The vertical is estimated from the heights of three or more control points, else from the cameras. Check
    points are only compared with the result.
    """
    fit = _fit(submodel, known, points=[point for point in points if not point.is_check])
    tried = [triangulate(point, submodel) for point in points if point.is_check]
    checks = [one for one in tried if isinstance(one, Triangulated)]
    problems = tuple(one for one in tried if isinstance(one, NotTriangulated))
    if isinstance(fit.aligned, NotAligned):
        fits = _unjudged(checks)
    else:
        fits = tuple(_checked(one, fit.aligned, level=fit.level) for one in checks)
    return Georegistration(fit.aligned, (*fit.points, *fits), (*fit.problems, *problems))


class _Fit(NamedTuple):
    """The alignment by control points, these, those that could not be triangulated, and the level of their
    heights."""

    aligned: AlignedSubmodel | NotAligned
    points: tuple[PointFit, ...]
    problems: tuple[NotTriangulated, ...]
    level: _Level | None = None


class _Level(NamedTuple):
    """Mean of the control points whose heights are known: how far down, in the submodel's world, and how high
    on the map."""

    down: float
    height_px: float


def _fit(submodel: Submodel, known: KnownPositions, *, points: Sequence[KnownPoint]) -> _Fit:
    tried = [triangulate(point, submodel) for point in points]
    found = [one for one in tried if isinstance(one, Triangulated)]
    problems = tuple(one for one in tried if isinstance(one, NotTriangulated))
    if not found:
        return _Fit(align_submodel(submodel, known), (), problems)
    placed = np.isfinite(known.at[submodel.photo])
    names = ", ".join(one.point.name for one in found)
    view = _view(submodel, known, found)
    if view is None:
        reason = (
            "the vertical cannot be estimated from their cameras: give three control points a "
            "height, or place three photos"
        )
        return _Fit(NotAligned(reason, tuple(submodel.photo[placed].tolist())), _unjudged(found), problems)
    if placed.sum() + len(found) < 2:
        reason = f"only one position is known, that of the control point {names}"
        return _Fit(NotAligned(reason), _unjudged(found), problems)
    both = _Extended.of(submodel, known, found=found, view=view)
    aligned = both.align()
    if isinstance(aligned, NotAligned):
        photos = tuple(number for number in aligned.photos if number < len(known.at))
        reason = f"{aligned.reason} (control points: {names})"
        return _Fit(NotAligned(reason, photos), _unjudged(found), problems)
    fits = _fits(aligned, found, first=len(submodel))
    right = [one for one, fit in zip(found, fits, strict=True) if not fit.contradicts]
    return _Fit(_of_photos(aligned, submodel), fits, problems, _level(right, down=view.frame[2]))


def _level(found: Sequence[Triangulated], *, down: Array) -> _Level | None:
    """Return the level of the control points with a height; None if none has one."""
    known = [one for one in found if math.isfinite(one.point.height_px)]
    if not known:
        return None
    depths, heights = ([one.at @ down for one in known], [one.point.height_px for one in known])
    return _Level(float(np.mean(depths)), float(np.mean(heights)))


def _checked(one: Triangulated, aligned: AlignedSubmodel, *, level: _Level | None) -> PointFit:
    """Compare a check point with where the fit puts it."""
    there, down = aligned.transform.map_point(one.at), aligned.transform.frame[2]
    scale = abs(there.factor)
    height = math.nan if level is None else level.height_px + scale * (level.down - float(one.at @ down))
    return PointFit(
        one.point.name,
        one.point.at,
        there.at,
        False,
        one.wrong,
        len(one.row),
        _sigma_px(one, aligned, scale=scale),
        height - one.point.height_px,
    )


def _sigma_px(one: Triangulated, aligned: AlignedSubmodel, *, scale: float) -> float:
    plan = aligned.transform.frame[:2]
    return math.hypot(
        one.point.sigma_px, scale * math.sqrt(float(np.trace(plan @ one.covariance @ plan.T)) / 2.0)
    )


def _view(submodel: Submodel, known: KnownPositions, found: Sequence[Triangulated]) -> PlanView | None:
    return view_by_heights(
        submodel,
        centre=np.array([one.at for one in found]),
        position=np.array([one.point.at for one in found]),
        height=np.array([one.point.height_px for one in found]),
    ) or choose_view(submodel, known)


@dataclass(frozen=True, slots=True, eq=False)
class _Extended:
    """A submodel whose control points are treated as further photos."""

    submodel: Submodel
    known: KnownPositions
    view: PlanView

    @classmethod
    def of(
        cls, submodel: Submodel, known: KnownPositions, *, found: Sequence[Triangulated], view: PlanView
    ) -> _Extended:
        photos, down = len(known.at), view.frame[2]
        # each point is moved vertically to the mean height of the cameras that see it, like another camera
        level = [one.at + float((submodel.centre[one.row].mean(0) - one.at) @ down) * down for one in found]
        centre = np.array(level)
        plan = (centre @ view.frame[:2].T) @ np.array([1.0, 1j])
        at = np.array([one.point.at for one in found])
        scale = _spread(np.append(known.at[submodel.photo], at)) / max(
            _spread(np.append(np.where(np.isfinite(known.at[submodel.photo]), view.position, np.nan), plan)),
            1e-300,
        )
        spread = [np.trace(view.frame[:2] @ one.covariance @ view.frame[:2].T) / 2.0 for one in found]
        sigma = np.hypot([one.point.sigma_px for one in found], scale * np.sqrt(spread))
        return cls(
            Submodel(
                np.append(submodel.photo, photos + np.arange(len(found))),
                np.concatenate([submodel.centre, centre]),
                np.concatenate([submodel.rotation, np.tile(np.eye(3), (len(found), 1, 1))]),
                submodel.error_rate,
            ),
            KnownPositions(
                np.append(known.at, at),
                np.append(known.sigma_px, sigma),
                np.append(known.derived, np.zeros(len(found), np.bool_)),
            ),
            PlanView(
                np.append(view.position, plan), np.append(view.forward, np.ones(len(found))), view.frame
            ),
        )

    def align(self) -> AlignedSubmodel | NotAligned:
        """Align it without the positions that contradict all others."""
        at, sigma = self.known.at[self.submodel.photo], self.known.sigma_px[self.submodel.photo]
        wrong = outlying_positions(self.view.position, at, sigma=sigma)
        kept = self.known.at.copy()
        kept[self.submodel.photo[wrong]] = complex(np.nan, np.nan)
        aligned = align_submodel(self.submodel, replace(self.known, at=kept), view=self.view)
        if isinstance(aligned, NotAligned) or not len(wrong):
            return aligned
        residual, others = aligned.residual_px.copy(), aligned.predicted.copy()
        contradicting = aligned.contradicting.copy()
        residual[wrong], others[wrong] = np.abs(at - aligned.at)[wrong], aligned.at[wrong]
        contradicting[wrong] = True
        return replace(aligned, residual_px=residual, predicted=others, contradicting=contradicting)


def _spread(points: Points) -> float:
    known = points[np.isfinite(points)]
    return float(np.sqrt(np.mean(np.abs(known - known.mean()) ** 2)))


def _of_photos(aligned: AlignedSubmodel, submodel: Submodel) -> AlignedSubmodel:
    """Drop the control points from the results; the transform keeps using them."""
    photos, used = len(submodel), aligned.transform
    placed = used.row < photos
    transform = replace(used, row=np.where(placed, used.row, -1))
    radius = None
    if placed.any():
        photos_used = PlacedPhotos(used.row, used.at, used.sigma_px, used.derived)
        radius = radius_by_covariance(submodel, photos_used.subset(placed))
    return AlignedSubmodel(
        aligned.at[:photos],
        aligned.radius_px[:photos] if radius is None else radius,
        aligned.angle_deg[:photos],
        aligned.residual_px[:photos],
        aligned.predicted[:photos],
        aligned.contradicting[:photos],
        transform,
    )


def _unjudged(found: Sequence[Triangulated]) -> tuple[PointFit, ...]:
    nowhere = complex(np.nan, np.nan)
    return tuple(
        PointFit(one.point.name, one.point.at, nowhere, False, one.wrong, len(one.row), math.nan)
        for one in found
    )


def _fits(aligned: AlignedSubmodel, found: Sequence[Triangulated], *, first: int) -> tuple[PointFit, ...]:
    return tuple(
        PointFit(
            one.point.name,
            one.point.at,
            complex(aligned.predicted[row]),
            bool(aligned.contradicting[row]),
            one.wrong,
            len(one.row),
            _sigma_px(one, aligned, scale=abs(aligned.transform.map_point(one.at).factor)),
        )
        for row, one in enumerate(found, first)
    )
