"""Joins the georegistered submodels of a reconstruction by placed photos and control points."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.control_points import KnownPoint
from webapp.core.landmarks.georegister import georegister
from webapp.core.landmarks.heights import Altitude, Altitudes
from webapp.core.landmarks.placing import AlignedSubmodel, KnownPositions, NotAligned
from webapp.core.landmarks.radii import sigma_of
from webapp.core.landmarks.submodels import Points, Submodel
from webapp.core.mapmodel.model import Map
from webapp.errors import IndexDamaged
from webapp.files.landmarks.adjust import AdjustJob
from webapp.files.landmarks.colmap import (
    RIGID_FILE,
    SUBMODELS_FILE,
    Model,
    StoredSubmodels,
    read_submodels,
    write_submodels,
)
from webapp.files.landmarks.position_priors import PicturePositions
from webapp.files.lock import writer_lock
from webapp.progress import Progress
from webapp.tasks.landmarks.altitudes import known_altitudes
from webapp.tasks.landmarks.control_points import found_points
from webapp.tasks.landmarks.known import known_positions
from webapp.tasks.landmarks.mapping import ADJUSTED, model_folders, run_adjustment
from webapp.tasks.landmarks.reconstruct import Reconstruction, keep_cloud, renumbered

Array = NDArray[np.float64]

_LEAST_KNOWN = 4
"""Minimum number of known positions for an adjustment: among three, a wrong one could not be detected."""

_LEAST_WIDE = 0.05
"""Ratio of the spreads of the known positions across and along, below which they are in a line."""

_HEIGHT_SHARE = 0.02
"""Standard deviation of a camera's height, which is unknown, over the extent of the known positions."""

_WORSE_SIGMAS = 2.5
"""Median residual of a submodel's known positions, in standard deviations, up to which an adjustment agrees
with them."""

_FOLDS, _MOST_FOLDED = 4, 60
"""Number of groups of known positions that are left out in turn to measure the error, and the number of known
positions above which their covariances suffice for that. Left out one by one, a piece with many positions
would vouch for others that only one or two hold."""

_LEAST_MEASURED, _MORE_ERROR = 3, 1.5
"""Number of left-out positions that must be measured, and the factor by which their median error may exceed
that of the submodels, each of which was measured by leaving out one position, not a quarter of them."""

_DISAGREE = "the photos do not agree with the positions"
_UNMEASURED = "too few positions can be left out to measure the error"

_FORMAT = 11
"""Part of the hash of the known positions: change it to recompute adjustments by new rules."""


@dataclass(frozen=True, slots=True, eq=False)
class Facts:
    """What is known about n photos, or about n pictures of them, besides what they show."""

    known: KnownPositions
    points: Sequence[KnownPoint] = ()
    altitudes: Altitudes | None = None  # None on a map of unknown scale


@dataclass(frozen=True, slots=True)
class AdjustedSubmodel:
    photos: tuple[int, ...]  # Numbers of its photos
    problem: str  # Why it was not adjusted; empty if it was
    # Distances of the adjusted cameras from the known positions, outliers included, by the photos' numbers.
    residual_px: Mapping[int, float]


def adjust_submodels(
    found: Reconstruction, the_map: Map, *, progress: Progress, wait_s: float = 0.0
) -> tuple[Reconstruction, list[AdjustedSubmodel]]:
    """Join submodels by the placed photos and those with GPS, each weighted by its accuracy.

    Placed photos that contradict the others of their submodel take no part. Submodels that cannot be
    georegistered stay unchanged; all do if the known positions are too few or in a line, or if the photos do
    not agree with them. The result is stored, and not computed again for the same positions.

    Raises:
        IndexDamaged: The reconstruction is gone from the disk.
    """
    with writer_lock(found.shared, wait_s=wait_s):
        rigid, now = (read_submodels(found.folder / name) for name in (RIGID_FILE, SUBMODELS_FILE))
        if rigid is None:
            raise IndexDamaged("the stored pieces are missing", where=str(found.folder), hint="run it again")
        known = known_positions(found.photos, the_map)
        points = [point for point in found_points(found, the_map) if not point.is_check]
        altitudes = known_altitudes(found.altitude_of, the_map, count=len(found.photos))
        facts = Facts(known, points, altitudes)
        adjusted = _key_of(known, the_map, altitudes)
        if now is None or (now.key, now.adjusted) != (rigid.key, adjusted):
            now = _adjust(rigid, facts, found=found, adjusted=adjusted, progress=progress)
            write_submodels(found.folder / SUBMODELS_FILE, now)
            _remove_others(found.folder / ADJUSTED, "" if now.problem else adjusted)
        keep_cloud(found.folder, now, features=found.shared)
    submodels = tuple(renumbered(now, found.number_of, turn_of=found.turn_of))
    return replace(found, submodels=submodels), [
        *_reports(submodels, now.problem, known=known, points=points)
    ]


def _key_of(known: KnownPositions, the_map: Map, altitudes: Altitudes | None = None) -> str:
    rows = np.column_stack([known.at.real, known.at.imag, known.sigma_px, known.derived]).round(3).tolist()
    points = [
        asdict(point) for point in the_map.control_points if point.position is not None and not point.is_check
    ]
    heights = None if altitudes is None else asdict(altitudes)
    return hashlib.sha256(json.dumps([_FORMAT, rows, points, heights]).encode()).hexdigest()[:16]


def _remove_others(folder: Path, kept: str) -> None:
    for other in folder.glob("*"):
        if other.name != kept:
            shutil.rmtree(other, ignore_errors=True)


def _adjust(
    rigid: StoredSubmodels, facts: Facts, *, found: Reconstruction, adjusted: str, progress: Progress
) -> StoredSubmodels:
    """Join the submodels that can be georegistered, and measure the result by leaving out known positions."""
    known, joining = facts.known, _Joining(rigid, facts, found)
    out = found.folder / ADJUSTED / adjusted
    progress.note("adjusting the pieces to the known positions")
    joined = joining.join(known, out=out, progress=progress)
    if isinstance(joined, str):
        return replace(rigid, adjusted=adjusted, problem=joined)
    numbers = joining.pictures[joined.photo]
    others = [
        submodel
        for number, submodel in enumerate(rigid.submodels)
        if number not in joined.submodels and not np.isin(submodel.photo, joined.photo).any()
    ]
    left_out = _left_out(joining, known, numbers, out=out, progress=progress)
    problem = left_out is not None and _refused(left_out, numbers, joining.predicted(known), known=known)
    if problem:
        return replace(rigid, adjusted=adjusted, problem=problem)
    whole = Submodel(
        joined.photo,
        joined.model.centre,
        joined.model.rotation,
        covariance=joined.model.covariance,
        left_out=left_out,
    )
    return replace(rigid, submodels=(whole, *others), adjusted=adjusted, problem="")


def _left_out(
    joining: _Joining, known: KnownPositions, numbers: NDArray[np.int64], *, out: Path, progress: Progress
) -> Array | None:
    """Adjust again without each fold of the known positions; see `Submodel.left_out`.

    Args:
        numbers: (n,) int64. Photo of each picture of the joined model.

    Returns:
        None for many known positions, whose covariances suffice, and where too few would remain.
    """
    judges = np.unique(numbers[np.isfinite(known.at[numbers]) & ~known.derived[numbers]])
    if not _LEAST_KNOWN <= len(judges) <= _MOST_FOLDED:
        return None
    left_out = np.full((len(numbers), 3), np.nan)
    folds = min(_FOLDS, len(judges))
    progress.note("measuring the error without some of the positions")
    for fold in range(folds):
        hidden = judges[fold::folds]
        at = known.at.copy()
        at[hidden] = complex(math.nan, math.nan)
        apart = out.with_name(f"{out.name}-without")
        there = joining.join(replace(known, at=at), out=apart, progress=progress, least=_LEAST_KNOWN - 1)
        shutil.rmtree(apart, ignore_errors=True)
        if isinstance(there, str):
            continue
        covariance = there.model.covariance
        # a large model has none: its radii follow from distances
        sigma = np.ones(len(there.photo)) if covariance is None else sigma_of(covariance)
        place = np.column_stack([there.model.centre[:, :2], sigma / np.median(sigma)])
        of_photo = dict(zip(joining.pictures[there.photo].tolist(), place, strict=True))
        for row in np.flatnonzero(np.isin(numbers, hidden)).tolist():
            left_out[row] = of_photo.get(int(numbers[row]), math.nan)
    return left_out


def _refused(
    left_out: Array, numbers: NDArray[np.int64], before: Mapping[int, float], *, known: KnownPositions
) -> str:
    """Return why an adjustment is not known to be nearly as good as the submodels without it; empty if it is.

    Args:
        left_out, numbers: See `Submodel.left_out`, and the photos of its rows.
        before: Errors of positions that the submodels predict from the others, by photo.
    """
    measured = np.flatnonzero(np.isfinite(left_out[:, 0]))
    # the views of a panorama are one position
    measured = measured[np.unique(numbers[measured], return_index=True)[1]]
    off = np.abs(left_out[measured, 0] + 1j * left_out[measured, 1] - known.at[numbers[measured]])
    if len(off) < _LEAST_MEASURED:
        return _UNMEASURED
    rows = [
        (after, before[n]) for after, n in zip(off, numbers[measured].tolist(), strict=True) if n in before
    ]
    if len(rows) < _LEAST_MEASURED:
        return ""
    after, usual = np.median(rows, axis=0)
    accurate_to = np.median(known.sigma_px[numbers[measured]])
    return "" if after <= _MORE_ERROR * max(usual, accurate_to) else _DISAGREE


class _Joined(NamedTuple):
    """A joined model."""

    model: Model
    photo: NDArray[np.int64]  # (n,) int64. Its pictures, as rows of the stored submodels' contents.
    submodels: Collection[int]  # Numbers of those that were joined


class _Joining:
    """Joins the rigid submodels of a reconstruction by known positions."""

    def __init__(self, rigid: StoredSubmodels, facts: Facts, found: Reconstruction) -> None:
        self._rigid, self._facts, self._found = rigid, facts, found
        self._of_photos = [*renumbered(rigid, found.number_of, turn_of=found.turn_of)]
        self.pictures = np.array([found.number_of[content] for content in rigid.contents], np.int64)

    def join(
        self, known: KnownPositions, *, out: Path, progress: Progress, least: int = _LEAST_KNOWN
    ) -> _Joined | str:
        """Join the submodels that can be georegistered; return why not, if they cannot be joined.

        Args:
            out: Folder for the joined model.
            least: Minimum number of known positions.
        """
        rigid = self._rigid
        results = [georegister(submodel, known, points=self._facts.points) for submodel in self._of_photos]
        row = {content: n for n, content in enumerate(rigid.contents)}
        contradict: set[int] = set()  # Numbers of submodels
        while True:
            used = {
                number: result.aligned
                for number, result in enumerate(results)
                if isinstance(result.aligned, AlignedSubmodel) and number not in contradict
            }
            problem = _too_little([*used.values()], least=least)
            if problem:
                return _DISAGREE if contradict else problem
            wrong = {fit.name for result in results for fit in result.points if fit.contradicts}
            points = [point for point in self._facts.points if point.name not in wrong]
            positions = self._positions(known, used, points=points, left_out=contradict)
            model = self._adjusted(positions, used, out=out, progress=progress)
            if model is None:
                return _DISAGREE
            photo = np.array([row[content] for content in model.contents], np.int64)
            there = Submodel(self.pictures[photo], model.centre, model.rotation)
            worse = {
                number
                for number, aligned in used.items()
                if _contradicts(self._of_photos[number], aligned, joined=there, known=known)
            }
            if not worse:
                return _Joined(model, photo, used.keys())
            contradict |= worse

    def predicted(self, known: KnownPositions) -> dict[int, float]:
        """Return the errors of known positions that their submodels predict from the others, by photo."""
        errors: dict[int, float] = {}
        for submodel in self._of_photos:
            aligned = georegister(submodel, known, points=self._facts.points).aligned
            if isinstance(aligned, AlignedSubmodel):
                rows = np.flatnonzero(np.isfinite(aligned.residual_px))
                errors |= zip(submodel.photo[rows].tolist(), aligned.residual_px[rows].tolist(), strict=True)
        return errors

    def _positions(
        self,
        known: KnownPositions,
        used: Mapping[int, AlignedSubmodel],
        *,
        points: Sequence[KnownPoint],
        left_out: Collection[int],
    ) -> PicturePositions:
        """Collect the known positions of the pictures that are in none of the submodels `left_out`, without
        those that contradict others of their submodel."""
        rigid, at = self._rigid, known.at.copy()
        for order, aligned in used.items():
            at[self._of_photos[order].photo[aligned.contradicting]] = complex(math.nan, math.nan)
        hidden = np.zeros(len(rigid.contents), np.bool_)
        for order in left_out:
            hidden[rigid.submodels[order].photo] = True
        for order in used:  # submodels may share a photo
            hidden[rigid.submodels[order].photo] = False
        shown = np.flatnonzero(~hidden)
        contents, number = [rigid.contents[row] for row in shown.tolist()], self.pictures[shown]
        altitudes = self._facts.altitudes
        return positions_of(
            contents,
            Facts(
                KnownPositions(at[number], known.sigma_px[number], known.derived[number]),
                points,
                None if altitudes is None else altitudes.subset(number.tolist()),
            ),
            photo=number,
            turn_deg=np.array([self._found.turn_of.get(content, 0) for content in contents], np.int64),
        )

    def _adjusted(
        self,
        positions: PicturePositions,
        used: Mapping[int, AlignedSubmodel],
        *,
        out: Path,
        progress: Progress,
    ) -> Model | None:
        job = adjust_job(
            self._rigid,
            positions,
            aligned=[(self._rigid.submodels[number], aligned) for number, aligned in used.items()],
            matches=self._found.matches,
            folder=self._found.folder,
            out=out,
        )
        return run_adjustment(job, progress=progress)


def _contradicts(
    submodel: Submodel, before: AlignedSubmodel, *, joined: Submodel, known: KnownPositions
) -> bool:
    """Return whether the joined model is farther from a submodel's known positions than they are accurate,
    and farther than they were from where the others put them."""
    there = dict(zip(joined.photo.tolist(), joined.centre[:, :2] @ np.array([1.0, 1j]), strict=True))
    rows = [
        (abs(there[number] - known.at[number]), known.sigma_px[number], before.residual_px[row])
        for row, number in enumerate(submodel.photo.tolist())
        if number in there and np.isfinite(known.at[number]) and not before.contradicting[row]
    ]
    if not rows:
        return False
    off, sigma, left_out = np.array(rows).T
    measured = left_out[np.isfinite(left_out)]
    usual = float(np.median(measured)) if len(measured) else 0.0
    return bool(np.median(off / sigma) > _WORSE_SIGMAS and np.median(off) > usual)


def _too_little(aligned: Sequence[AlignedSubmodel], *, least: int) -> str:
    """Return why the known positions do not suffice for an adjustment; empty if they do."""
    at = np.concatenate([np.zeros(0, np.complex128), *(result.transform.at for result in aligned)])
    if len(at) < least:
        return f"{len(at)} positions are known, {least} are needed"
    off = at - at.mean()
    along, across = np.linalg.svd(np.column_stack([off.real, off.imag]), compute_uv=False)
    return "the known positions are in a line" if across < _LEAST_WIDE * along else ""


def positions_of(
    contents: Sequence[str], facts: Facts, *, photo: NDArray[np.int64], turn_deg: NDArray[np.int64]
) -> PicturePositions:
    """Collect what is known about pictures (photos and views of panoramas) and control points.

    Args:
        facts: Positions of the pictures, NaN for outliers; control points, without outliers; altitudes of the
            pictures.
        photo, turn_deg: array. See `PicturePositions`.
    """
    known, points = facts.known, facts.points
    usable = np.flatnonzero(np.isfinite(known.at))
    at = np.append(known.at[usable], [point.at for point in points])
    where = np.column_stack([at.real, at.imag])
    usual_px = _HEIGHT_SHARE * float(np.ptp(where, axis=0).max())
    altitudes = facts.altitudes or Altitudes((Altitude(),) * len(contents), 1.0)
    _, first, row = np.unique(photo, return_index=True, return_inverse=True)  # a panorama counts once
    return PicturePositions(
        tuple(contents),
        photo,
        turn_deg,
        tuple(contents[number] for number in usable.tolist()),
        where[: len(usable)],
        known.sigma_px[usable],
        usual_px,
        tuple(points),
        altitudes.subset(first.tolist()).heights(usual_px=usual_px).subset(row),
    )


def adjust_job(
    rigid: StoredSubmodels,
    positions: PicturePositions,
    *,
    aligned: Sequence[tuple[Submodel, AlignedSubmodel]],
    matches: Path,
    folder: Path,
    out: Path,
) -> AdjustJob:
    """Make the adjustment job, with all pictures of the submodels placed by the known positions near them.

    Args:
        aligned: Submodels of pictures, with their georegistrations.
        matches, folder, out: The database, the folder of the reconstruction, and that for the joined model.
    """
    placed, height_of = dict(zip(positions.known, positions.at, strict=True)), positions.height_of
    contents: list[str] = []
    centre, rotation = [np.zeros((0, 3))], [np.zeros((0, 3, 3))]
    for submodel, result in aligned:
        there = result.transform.map_cameras(submodel.centre)
        names = [rigid.contents[number] for number in submodel.photo.tolist()]
        at = np.column_stack([there.at.real, there.at.imag])
        at = np.array([placed.get(name, own) for name, own in zip(names, at, strict=True)])
        contents += names
        centre.append(np.column_stack([at, [-height_of.get(name, 0.0) for name in names]]))
        to_map = _to_map(there.factor) @ result.transform.frame
        rotation.append(submodel.rotation @ np.swapaxes(to_map, 1, 2))
    cameras = tuple(contents), np.concatenate(centre), np.concatenate(rotation)
    return AdjustJob(matches, tuple(model_folders(folder)), out, *cameras, positions)


def _to_map(factor: Points) -> Array:
    """Return the rotations (n, 3, 3) from a submodel's plan view to the map, by its cameras' factors (n,)."""
    turn = factor / np.abs(factor)
    level = np.zeros((len(turn), 3, 3))
    level[:, 0, 0] = level[:, 1, 1] = turn.real
    level[:, 0, 1], level[:, 1, 0] = -turn.imag, turn.imag
    level[:, 2, 2] = 1.0
    return level


def _reports(
    submodels: Sequence[Submodel], problem: str, *, known: KnownPositions, points: Sequence[KnownPoint]
) -> Iterator[AdjustedSubmodel]:
    for order, submodel in enumerate(submodels):
        photos = tuple(submodel.photo.tolist())
        if order == 0 and not problem:
            off = np.abs(submodel.centre[:, 0] + 1j * submodel.centre[:, 1] - known.at[submodel.photo])
            there = zip(photos, off.tolist(), strict=True)
            yield AdjustedSubmodel(photos, "", {n: away for n, away in there if not math.isnan(away)})
            continue
        aligned = georegister(submodel, known, points=points).aligned
        yield AdjustedSubmodel(photos, aligned.reason if isinstance(aligned, NotAligned) else problem, {})
