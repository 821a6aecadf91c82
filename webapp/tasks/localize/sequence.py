"""Says where the frames of a sequence were taken, each by its own content and by the frames before it."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path

from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.sequence import Belief, MotionModel, filter_step, motion_model_on
from webapp.errors import PhotoError, UsageError
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits
from webapp.tasks.localize.photo import PhotoLocalizer, parts

FRAME_TOP = 10
"""So many hypotheses of each frame are looked at."""

_LEAST_STEP = 0.5
"""EXIF often counts whole seconds: photos of one second were not taken at once."""


def motion(localizer: PhotoLocalizer, *, speed_px: float | None = None) -> MotionModel:
    """Describe the motion over the map of a localizer."""
    return motion_model_on(localizer.opened.indexed.paths, speed_px=speed_px)


@dataclass(slots=True)
class _Memory:
    """What changes from frame to frame."""

    belief: Belief = field(default_factory=Belief)


@dataclass(frozen=True, slots=True, eq=False)
class SequenceLocalizer(PhotoLocalizer):
    """A method on an open map that remembers: photos must come in the order in which they were taken.

    Attributes
    ----------
    speed_px : float or None
        Usual way from a frame to the next, map pixels; None for that of most sequences.
    steps : mapping of Path to float
        Time since the frame before, in usual intervals, where it is not 1.
    """

    speed_px: float | None = None
    steps: Mapping[Path, float] = field(default_factory=dict)
    _memory: _Memory = field(default_factory=_Memory, init=False)

    def localize(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        """Localize the next frame.

        Raises
        ------
        PhotoError
            The photo cannot be used; the sequence goes on without it.
        """
        alone = self.look(photo_path, top=FRAME_TOP, hide=hide)
        self._memory.belief, answer = filter_step(
            self._memory.belief,
            alone,
            motion=motion(self, speed_px=self.speed_px),
            top=top,
            steps=self.steps.get(photo_path, 1.0),
        )
        return answer


def of(
    localizer: PhotoLocalizer, *, speed_px: float | None = None, steps: Mapping[Path, float] | None = None
) -> SequenceLocalizer:
    """Make a localizer remember."""
    return SequenceLocalizer(**parts(localizer), speed_px=speed_px, steps=steps or {})


def by_time(photos: Sequence[Path], *, limits: PhotoLimits) -> tuple[tuple[Path, ...], dict[Path, float]]:
    """Put photos into the order in which they were taken.

    Parameters
    ----------
    photos : sequence of Path
    limits : PhotoLimits

    Returns
    -------
    photos : tuple of Path
    steps : dict
        Time since the photo before, over the median of all such times; as `SequenceLocalizer` needs it.

    Raises
    ------
    UsageError
        A photo does not tell when it was taken.
    """
    times = {photo: _taken_at(photo, limits) for photo in photos}
    dated = sorted((photo for photo in times if times[photo] is not None), key=lambda p: times[p] or 0.0)
    broken = [photo for photo in times if times[photo] is None]
    moments = [times[photo] or 0.0 for photo in dated]
    gaps = [after - before for before, after in pairwise(moments)]
    usual = statistics.median(gaps) if gaps else 0.0
    steps = (
        {p: max(gap / usual, _LEAST_STEP) for p, gap in zip(dated[1:], gaps, strict=True)} if usual else {}
    )
    return (*dated, *broken), steps


def _taken_at(photo: Path, limits: PhotoLimits) -> float | None:
    """Seconds by the camera's clock; None for a photo that cannot be read, which localizing it will tell."""
    try:
        taken_at = read_facts(photo, limits=limits).taken_at
    except PhotoError:
        return None
    if taken_at is None:
        raise UsageError(
            f"{photo.name} does not tell when it was taken",
            where="--by-time",
            hint="name the photos in their order and leave --by-time out",
        )
    return datetime.fromisoformat(taken_at).replace(tzinfo=UTC).timestamp()
