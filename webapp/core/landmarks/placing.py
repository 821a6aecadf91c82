"""Aligns a submodel with the map by its placed photos, and proposes which to place next.

A long submodel drifts, and a plan may not be to scale, so each photo has a similarity of its own, in which
near placed photos weigh more (moving least squares: S. Schaefer, T. McPhail, J. Warren, "Image deformation
using moving least squares", 2006). The fall of the weights is chosen by leave-one-out cross-validation of the
placed photos, which also measures the error of a suggestion and finds placed photos that contradict the
others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.radii import (
    PlacedPhotos,
    error_rate_of,
    radius_by_covariance,
    radius_by_distance,
)
from webapp.core.landmarks.submodels import (
    PlanView,
    Points,
    Submodel,
    view_by_level_cameras,
    view_by_plane,
    view_by_positions,
    view_of_map,
)

Array = NDArray[np.float64]

_EXPONENTS = (0.0, 1.0, 2.0, 3.0)
"""Candidate powers of the squared distance by which the weight of a photo falls; at 0 all weigh the same."""

_NEAREST = 0.02
"""Added to distances in quadrature, as a fraction of the extent of the placed photos: limits the weights."""

_FEW = 4
"""Least number of placed photos among which a contradicting one can be identified."""

_CONTRADICTS, _CONTRADICTS_RELATIVE = 5.0, 0.7
"""A placed photo contradicts the others if its error is more than these multiples of the median error and of
the distance to the nearest other one."""

_WRONG_SIGMAS, _WRONG_RELATIVE = 6.0, 0.25
"""A position is an outlier to the similarity of all others from this many standard deviations on (times the
RMS of the others, if above 1); that of a photo also has to be off by this fraction of the distance to the
nearest other one, since models bend."""

_NEARER = 0.8
"""The vertical is found in another way if the positions that are left out are then nearer by this factor."""

_STEEP = np.cos(np.radians(30.0))
"""Cosine of the slope of the plane of the cameras above which they are not level: no path is as steep."""

_MISFIT = 0.5
"""RMS error of a similarity, as a fraction of the extent of the positions, above which it does not fit."""

_MIRRORED = 0.3
"""Positions are mirrored if the RMS error exceeds this fraction of their extent, and that of the mirror image
is less than this fraction of that error."""


@dataclass(frozen=True, slots=True, eq=False)
class KnownPositions:
    """Known positions of p photos, in the order of their numbers."""

    at: Points  # (p,) complex128. Map pixels, x + iy; NaN where unknown.
    sigma_px: Array  # (p,) float64. Standard deviation of each.
    # (p,) bool. Whether it was a suggestion from the photos that was accepted: a prior, but no measure of
    # errors.
    derived: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class AlignedSubmodel:
    """A submodel on the map; n photos."""

    at: Points  # (n,) complex128. Map pixels, also of the photos that are placed.
    radius_px: Array  # (n,) float64. 68 % radius.
    angle_deg: Array  # (n,) float64. Viewing direction, clockwise from image-up.
    # (n,) float64. Distance of each placed photo from its position predicted from the others; NaN for photos
    # that are not placed, and where too few are.
    residual_px: Array
    predicted: Points  # (n,) complex128. The predicted positions, of photos with a residual.
    # (n,) bool. Placed photos that were left out, because they contradict the others.
    contradicting: NDArray[np.bool_]
    transform: PlanTransform  # Maps further points and cameras of the submodel's world


@dataclass(frozen=True, slots=True, eq=False)
class PlanTransform:
    """Transformation from the world of a submodel to the map, by k placed photos."""

    frame: Array  # (3, 3) float64. See `PlanView`.
    row: NDArray[np.int64]  # (k,) int64. Their rows in the submodel; -1 for a control point.
    centre: Array  # (k, 3) float64. Their positions in the world of the submodel.
    at: Points  # (k,) complex128. Map pixels.
    sigma_px: Array  # (k,) float64
    derived: NDArray[np.bool_]  # (k,) bool. See `KnownPositions`.
    exponent: float  # Power of the squared distance by which their weight falls
    # (k,) float64. Leave-one-out errors over the distance to the nearest other one; NaN where not measured;
    # may be empty.
    relative: Array
    least_rate: float  # See `Submodel.error_rate`

    @property
    def error_rate(self) -> float:
        """Error over the distance to the nearest placed photo."""
        return max(self.least_rate, error_rate_of(self.relative))

    def without(self, hidden: NDArray[np.bool_]) -> PlanTransform | None:
        """Leave out hidden photos, (n,) of the submodel; None if fewer than two distinct positions remain."""
        kept = (self.row < 0) | ~hidden[self.row]
        if kept.all():
            return self
        if len(np.unique(self.at[kept])) < 2:
            return None
        relative = self.relative[kept] if len(self.relative) else self.relative
        known = (self.row[kept], self.centre[kept], self.at[kept], self.sigma_px[kept], self.derived[kept])
        return PlanTransform(self.frame, *known, self.exponent, relative, self.least_rate)

    def map_cameras(self, centre: Array) -> MapCameras:
        """Map the centres (n, 3) of cameras of the submodel, placed or not."""
        seen, own = centre @ self.frame.T, self.centre @ self.frame.T
        plan, targets = (c[:, 0] + 1j * c[:, 1] for c in (own, seen))
        known = self._known()
        at, factor = _moved(targets, known, exponent=self.exponent, plan=plan)
        weight = _weights(targets, known, exponent=self.exponent, plan=plan)
        return MapCameras(at, factor, np.abs(factor) * (weight @ own[:, 2] - seen[:, 2]))

    def map_point(self, centre: Array) -> MapPoint:
        """Map a point (3,) of the submodel's world."""
        seen, own = (self.frame @ centre), self.centre @ self.frame.T
        plan = own[:, 0] + 1j * own[:, 1]
        target = np.array([seen[0] + 1j * seen[1]])
        known = self._known()
        at, factor = _moved(target, known, exponent=self.exponent, plan=plan)
        radius = radius_by_distance(
            np.append(plan, target), known, factor=np.append(0.0 * plan, factor), rate=self.error_rate
        )
        nearest = np.abs(plan - target).argmin()
        height = float(abs(factor[0]) * (own[nearest, 2] - seen[2]))
        return MapPoint(complex(at[0]), complex(factor[0]), height, float(radius[-1]))

    def _known(self) -> PlacedPhotos:
        return PlacedPhotos(np.arange(len(self.at)), self.at, self.sigma_px, self.derived)


class MapCameras(NamedTuple):
    """Cameras on the map, (n,) each: position (pixels), local rotation and scale, and height (map pixels)
    above the mean of the placed cameras with the weights of the position."""

    at: Points
    factor: Points
    height_px: Array


class MapPoint(NamedTuple):
    """A point on the map: position (pixels), local rotation and scale, height above the nearest placed camera
    and 68 % radius of the position (map pixels)."""

    at: complex
    factor: complex
    height_px: float
    radius_px: float


@dataclass(frozen=True, slots=True)
class NotAligned:
    """A submodel cannot be aligned with the map, and the reason. Falsy."""

    reason: str
    photos: tuple[int, ...] = ()  # Numbers of the placed photos that the reason concerns

    def __bool__(self) -> bool:
        return False


def align_submodel(
    submodel: Submodel, known: KnownPositions, *, view: PlanView | None = None
) -> AlignedSubmodel | NotAligned:
    """Align a submodel with the map, by a given plan view or one that is estimated here."""
    at = known.at[submodel.photo]
    placed = np.isfinite(at)
    spots = len(np.unique(at[placed]))
    if spots < 2:
        which = "none of them is placed" if not placed.any() else "only one of them is placed"
        return NotAligned(which if spots == placed.sum() else "the placed ones are all at the same position")
    view = view or choose_view(submodel, known)
    if view is None:
        return NotAligned(
            "the vertical cannot be estimated from their cameras, and the placed ones are fewer than three "
            "or in a line",
            tuple(submodel.photo[placed].tolist()),
        )
    of_photos = _placed_of(submodel, known)
    wrong = _outlying_photos(view, of_photos)
    kept = of_photos.subset(~wrong)
    problem = _misfit(view.position[kept.row], kept.at)
    if problem:
        return NotAligned(problem, tuple(submodel.photo[placed].tolist()))
    return _naming(_align(submodel, view, kept), of_photos.subset(wrong))


def _placed_of(submodel: Submodel, known: KnownPositions) -> PlacedPhotos:
    at = known.at[submodel.photo]
    row = np.flatnonzero(np.isfinite(at))
    own = submodel.photo[row]
    return PlacedPhotos(row, at[row], known.sigma_px[own], known.derived[own])


def _outlying_photos(view: PlanView, known: PlacedPhotos) -> NDArray[np.bool_]:
    """Mask (k,) of the placed photos whose positions the others contradict; see `outlying_positions`."""
    judges = np.flatnonzero(known.judges)
    wrong = np.zeros(len(known.row), np.bool_)
    plan = view.position[known.row[judges]]
    odd = outlying_positions(plan, known.at[judges], sigma=known.sigma_px[judges], relative=_WRONG_RELATIVE)
    wrong[judges[odd]] = True
    return wrong


def _naming(aligned: AlignedSubmodel, wrong: PlacedPhotos) -> AlignedSubmodel:
    """Add the placed photos that were left out before the alignment."""
    if not len(wrong.row):
        return aligned
    residual, predicted = aligned.residual_px.copy(), aligned.predicted.copy()
    contradicting = aligned.contradicting.copy()
    residual[wrong.row] = np.abs(wrong.at - aligned.at[wrong.row])
    predicted[wrong.row], contradicting[wrong.row] = aligned.at[wrong.row], True
    return replace(aligned, residual_px=residual, predicted=predicted, contradicting=contradicting)


def choose_view(submodel: Submodel, known: KnownPositions) -> PlanView | None:
    """Find the vertical of a submodel; None if nothing determines it.

    Of the plan views by an adjustment, by level cameras, by the plane of all cameras and by the known
    positions, the first one is taken, unless known positions that are left out are clearly nearer in a later
    one. That takes three of them; with two, the plane of all cameras replaces level cameras if it is steep in
    their view.
    """
    placed = _placed_of(submodel, known)
    at = known.at[submodel.photo]
    ways = (
        view_of_map(submodel),
        view_by_level_cameras(submodel),
        view_by_plane(submodel),
        view_by_positions(submodel, known=np.isfinite(at), position=at),
    )
    views = [view for view in ways if view is not None]
    if not views:
        return None
    if len(placed.row) < 3:
        mapped, level, plane, _ = ways
        is_steep = level and plane and level.frame[2] @ plane.frame[2] < _STEEP
        return mapped or plane if is_steep else views[0]
    best, least = views[0], np.inf
    for view in views:
        refits = view is ways[-1] and len(placed.row) > 3
        error = _left_out_error(submodel, view, placed, refits=refits)
        if error < _NEARER * least:
            best, least = view, error
    return best


def _left_out_error(submodel: Submodel, view: PlanView, known: PlacedPhotos, *, refits: bool) -> float:
    """Return the RMS distance of known positions from where the others put them, without the outliers.

    Args:
        refits: The vertical depends on the positions: it is estimated again without each of them.
    """
    outlying = _outlying_photos(view, known)
    kept = known.subset(known.judges & ~outlying)
    if len(kept.row) < 3:
        return np.inf
    exponent, _, error, _ = _leave_one_out(view.position, kept)
    if refits:
        for number in range(len(kept.row)):
            others = np.arange(len(kept.row)) != number
            at = np.full(len(submodel), complex(np.nan, np.nan))
            at[kept.row[others]] = kept.at[others]
            again = view_by_positions(submodel, known=np.isfinite(at), position=at)
            if again is None:
                return np.inf
            plan, target = again.position, again.position[kept.row[number]][None]
            moved, _ = _moved(target, kept.subset(others), exponent=exponent, plan=plan)
            error[number] = abs(moved[0] - kept.at[number])
    # a view in which many positions are outliers is not better for that
    return float(np.sqrt(np.mean(error**2))) * (1.0 + float(np.mean(outlying)))


def outlying_positions(plan: Points, at: Points, *, sigma: Array, relative: float = 0.0) -> NDArray[np.int64]:
    """Find the positions to leave out so that the others fit one similarity within their accuracy.

    Args:
        plan: (n,) complex128. Positions in the plan view of the submodel.
        at: (n,) complex128. Positions on the map; NaN where unknown.
        sigma: (n,) float64
        relative: An outlier is off by at least this fraction of the distance to the nearest other position.
    """
    kept = np.flatnonzero(np.isfinite(at))
    most, odd = len(kept) // 3, list[int]()
    while len(kept) >= _FEW and len(odd) < most:
        fits = [_without(plan, at, sigma, kept=kept, odd=one) for one in kept.tolist()]
        worst = int(np.argmin([fit.usual for fit in fits]))
        one, others, fit = int(kept[worst]), np.delete(kept, worst), fits[worst]
        if fit.sigmas <= _WRONG_SIGMAS * max(1.0, fit.usual):
            break
        if fit.distance < relative * float(np.abs(at[others] - at[one]).min()):
            break
        odd.append(one)
        kept = others
    return np.array(odd, np.int64)


class _Left(NamedTuple):
    """A position, and the similarity of the others: how far off it is, also in standard deviations, in which
    the uncertainty of the fit is included; and the RMS of the others, in theirs."""

    distance: float
    sigmas: float
    usual: float


def _without(plan: Points, at: Points, sigma: Array, *, kept: NDArray[np.int64], odd: int) -> _Left:
    """Fit a similarity without one position."""
    rest = kept[kept != odd]
    information = sigma[rest] ** -2.0
    weight = information / information.sum()
    middle, goal = weight @ plan[rest], weight @ at[rest]
    off, wanted = plan[rest] - middle, at[rest] - goal
    extent = max(float(weight @ np.abs(off) ** 2), 1e-300)
    factor = (weight @ (off.conj() * wanted)) / extent
    residual = np.abs(wanted - factor * off) / sigma[rest]
    away = plan[odd] - middle
    variance = (1.0 + abs(away) ** 2 / extent) / information.sum()
    distance = abs(at[odd] - goal - factor * away)
    sigmas = distance / np.hypot(sigma[odd], np.sqrt(variance))
    return _Left(float(distance), float(sigmas), float(np.sqrt((residual**2).sum() / (len(rest) - 2))))


def _misfit(plan: Points, at: Points) -> str | None:
    """Return why no similarity, or only a mirrored one, fits the positions; None if there is no problem."""
    if len(plan) < 3:
        return None
    extent = np.sqrt(np.mean(np.abs(at - at.mean()) ** 2))
    direct, mirrored = (_global_rms(points, at) for points in (plan, np.conj(plan)))
    if direct > _MIRRORED * extent and mirrored < _MIRRORED * direct:
        return "the placed ones are a mirror image of what the photos show"
    if len(plan) < _FEW and direct > _MISFIT * extent:
        return "the positions of the placed ones contradict each other"
    return None


def _global_rms(plan: Points, at: Points) -> float:
    off, wanted = plan - plan.mean(), at - at.mean()
    factor = np.vdot(off, wanted) / max(float(np.vdot(off, off).real), 1e-300)
    return float(np.sqrt(np.mean(np.abs(wanted - factor * off) ** 2)))


def _align(submodel: Submodel, view: PlanView, known: PlacedPhotos) -> AlignedSubmodel:
    judges, kept = known.judges, np.ones(len(known.row), np.bool_)
    exponent, moved, error, relative = _leave_one_out(view.position, known.subset(judges))
    while len(error) >= _FEW:
        worst = int(np.argmax(error))
        usual = max(float(np.median(error)), 1.0)
        is_wrong = error[worst] > _CONTRADICTS * usual and relative[worst] > _CONTRADICTS_RELATIVE
        if not is_wrong or (judges & kept).sum() * 3 <= 2 * judges.sum():
            break
        kept[np.flatnonzero(judges & kept)[worst]] = False
        exponent, moved, error, relative = _leave_one_out(view.position, known.subset(judges & kept))
    used = known.subset(kept)
    at, factor = _moved(view.position, used, exponent=exponent, plan=view.position)
    residual = np.full(len(view.position), np.nan)
    predicted = np.full(len(view.position), complex(np.nan, np.nan))
    measured = known.row[judges & kept]
    if len(measured) > 2:
        residual[measured], predicted[measured] = error, moved
        measures = np.full(len(view.position), np.nan)
        measures[measured] = relative
        relative = measures[used.row]
    wrong = known.row[~kept]
    residual[wrong], predicted[wrong] = np.abs(known.at[~kept] - at[wrong]), at[wrong]
    contradicting = np.zeros(len(at), np.bool_)
    contradicting[wrong] = True
    radius = radius_by_covariance(submodel, used)
    if radius is None:
        rate = max(submodel.error_rate, error_rate_of(relative))
        radius = radius_by_distance(view.position, used, factor=factor, rate=rate)
        if len(measured) > 2:  # errors are not all due to distance
            radius = np.maximum(radius, np.median(error))
    return AlignedSubmodel(
        at,
        radius,
        np.degrees(np.arctan2((look := factor * view.forward).real, -look.imag)) % 360.0,
        residual,
        predicted,
        contradicting,
        PlanTransform(
            view.frame,
            used.row,
            submodel.centre[used.row],
            used.at,
            used.sigma_px,
            used.derived,
            exponent,
            relative,
            submodel.error_rate,
        ),
    )


def _leave_one_out(plan: Points, known: PlacedPhotos) -> tuple[float, Points, Array, Array]:
    """Choose the exponent with the least leave-one-out error of the placed photos.

    Returns:
        exponent:
        moved: (k,) complex128. Position of each predicted from the others, map pixels.
        error: (k,) float64. Distance of that from the known position.
        relative: (k,) float64. Error over the distance to the nearest other placed photo. The arrays are
            empty for fewer than three.
    """
    if len(known.row) < 3:
        return 0.0, np.zeros(0, np.complex128), np.zeros(0), np.zeros(0)
    best: tuple[float, Points, Array, Array] | None = None
    for exponent in _EXPONENTS:
        moved, factor = _moved(plan[known.row], known, exponent=exponent, plan=plan, leave_out=True)
        error = np.abs(moved - known.at)
        if best is None or np.median(error) < np.median(best[2]):
            apart = np.abs(plan[known.row][:, None] - plan[known.row])
            np.fill_diagonal(apart, np.inf)
            away = np.maximum(apart.min(1) * np.abs(factor), 1.0)
            best = exponent, moved, error, error / away
    assert best is not None
    return best


def _moved(
    targets: Points, known: PlacedPhotos, *, exponent: float, plan: Points, leave_out: bool = False
) -> tuple[Points, Points]:
    """Map points, each by a weighted similarity of its own.

    Args:
        targets: (t,) complex128
        leave_out: Target i is placed photo i, which is not used for it.

    Returns:
        at, factor: (t,) complex128. Their positions on the map, and the local rotation and scale.
    """
    source = plan[known.row]
    weight = _weights(targets, known, exponent=exponent, plan=plan, leave_out=leave_out)
    middle, goal = weight @ source, weight @ known.at
    off, wanted = source - middle[:, None], known.at - goal[:, None]
    spread = (weight * np.abs(off) ** 2).sum(1)
    factor = (weight * np.conj(off) * wanted).sum(1) / np.maximum(spread, 1e-300)
    return goal + factor * (targets - middle), factor


def _weights(
    targets: Points, known: PlacedPhotos, *, exponent: float, plan: Points, leave_out: bool = False
) -> Array:
    """Return the weights (t, k) of the placed photos for each target; each row adds up to 1."""
    source = plan[known.row]
    floor = _NEAREST * float(np.sqrt(np.mean(np.abs(source - source.mean()) ** 2)))
    apart = np.abs(targets[:, None] - source) ** 2 + floor**2
    weight: Array = (apart / apart.min(1, keepdims=True)) ** -exponent / known.sigma_px**2
    if leave_out:
        np.fill_diagonal(weight, 0.0)
    weight /= weight.sum(1, keepdims=True)
    return weight


_CHECKED = 4
"""Placed photos of a submodel from which on a wrong one can be named."""

_CHECK = 0.5
"""What a checked position is worth over a new one."""

_STRAY = 4.0
"""Cameras farther from the median position than this multiple of the median distance may be wrong in the
submodel, and are not proposed."""


def propose_next(
    submodels: Sequence[Submodel],
    aligned: Sequence[AlignedSubmodel | NotAligned],
    *,
    known: KnownPositions,
    most: int,
) -> list[int]:
    """Propose photos to place, the most useful first.

    A submodel that is not on the map yet needs two photos, far apart; one with two or three needs more of
    them, as its positions are not checked. These come in the order of the photos that each click places or
    checks. Then comes the most uncertain photo of each other submodel.
    """
    placed = np.isfinite(known.at)
    useful: list[tuple[float, list[int]]] = []
    unsure: list[tuple[float, int]] = []
    for submodel, result in zip(submodels, aligned, strict=True):
        own = placed[submodel.photo]
        if isinstance(result, NotAligned):
            photos = _far_apart(submodel, own)
            useful.append(((len(own) - 2) / max(len(photos), 1), photos))
        elif own.sum() < _CHECKED:
            useful.append((_CHECK * (len(own) - own.sum()) / 2, _far_apart(submodel, own)))
        else:
            photo, radius = _least_certain(submodel, result, own)
            unsure += [(radius, photo)] if photo >= 0 else []
    useful.sort(key=lambda one: -one[0])
    ordered = [*(photo for _, photos in useful for photo in photos), *(n for _, n in sorted(unsure)[::-1])]
    return ordered[:most]


def _far_apart(submodel: Submodel, placed: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[int]:
    """Choose the two photos that are farthest apart, or the one farthest from those that are placed."""
    off = np.linalg.norm(submodel.centre - np.median(submodel.centre, axis=0), axis=1)
    usable = off <= (_STRAY * np.median(off) or np.inf)
    apart = np.linalg.norm(submodel.centre[:, None] - submodel.centre, axis=2)
    apart[~usable] = apart[:, ~usable] = 0.0
    if not placed.any():
        return [int(n) for n in submodel.photo[list(np.unravel_index(apart.argmax(), apart.shape))]]
    away = np.where(placed | ~usable, -1.0, apart[:, placed].min(1))
    return [int(submodel.photo[away.argmax()])] if away.max() > 0.0 else []


def _least_certain(
    submodel: Submodel, aligned: AlignedSubmodel, placed: np.ndarray[tuple[int], np.dtype[np.bool_]]
) -> tuple[int, float]:
    radius = np.where(placed, -1.0, aligned.radius_px)
    row = int(radius.argmax())
    return (int(submodel.photo[row]), float(radius[row])) if radius[row] >= 0.0 else (-1, 0.0)
