"""Localizes the frames of a sequence: live (filtering) or recorded (smoothing)."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

from webapp.core.hypotheses.bayes import truncate
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.sequence import Belief, MotionModel, filter_step, motion_model, smooth
from webapp.errors import PhotoError, UsageError
from webapp.files.photos.photo import read_facts
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.localize.pipeline import LocalizationPipeline

FRAME_TOP = 10
"""Number of hypotheses considered per frame."""

_LEAST_STEP = 0.5
"""Minimum time step: EXIF often has whole seconds, so that equal times do not mean simultaneous photos."""


def motion(pipeline: LocalizationPipeline, *, speed_px: float | None = None) -> MotionModel:
    """Return the motion model of a camera on the map."""
    return motion_model(pipeline.opened.indexed.paths, speed_px=speed_px)


class SequenceFilter:
    """Localizes the frames of a sequence one by one, each using all previous frames.

    Args:
        speed_px: Typical distance between consecutive frames, map pixels; None for the default.
        steps: Time since the previous frame, in typical frame intervals, where it is not 1.
    """

    def __init__(
        self,
        pipeline: LocalizationPipeline,
        *,
        speed_px: float | None = None,
        steps: Mapping[Path, float] = MappingProxyType({}),
    ) -> None:
        self._pipeline = pipeline
        self._motion = motion(pipeline, speed_px=speed_px)
        self._steps = steps
        self._belief = Belief()

    def localize(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        """Localize the next frame.

        Raises:
            PhotoError: The photo cannot be used; the sequence continues without it.
        """
        alone = self._pipeline.observe(photo_path, top=FRAME_TOP, hide=hide)
        self._belief, answer = filter_step(
            self._belief, alone, motion=self._motion, top=top, steps=self._steps.get(photo_path, 1.0)
        )
        return self._pipeline.limit_accuracy(answer)


class SmoothedSequence:
    """Answers about the frames of a recorded sequence, smoothed over all frames.

    Args:
        answers: The result of each frame.
    """

    def __init__(self, answers: Mapping[Path, Answer | PhotoError]) -> None:
        self._answers = answers

    def localize(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        """Return the answer about a frame.

        Raises:
            PhotoError: The photo could not be used.
        """
        found = self._answers[photo_path]
        if isinstance(found, PhotoError):
            raise found
        return truncate(found, top)


def smooth_sequence(
    pipeline: LocalizationPipeline,
    photos: Sequence[Path],
    *,
    progress: Progress,
    speed_px: float | None = None,
    steps: Mapping[Path, float] = MappingProxyType({}),
) -> SmoothedSequence:
    """Localize all frames of a sequence, smoothed over all of them. Raises Cancelled.

    Args:
        photos: In the order of capture.
        progress: One step per photo.
        speed_px: Typical distance between consecutive frames, map pixels.
        steps: Time since the previous frame, in typical frame intervals, where it is not 1.
    """
    progress.size(len(photos))
    found: dict[Path, Answer | PhotoError] = {}
    for photo in photos:
        progress.check()
        try:
            found[photo] = pipeline.observe(photo, top=FRAME_TOP)
        except PhotoError as error:
            found[photo] = error
        progress.advance()
    frames = {photo: answer for photo, answer in found.items() if isinstance(answer, Answer)}
    smoothed = smooth(
        list(frames.values()),
        motion=motion(pipeline, speed_px=speed_px),
        top=FRAME_TOP,
        steps=[steps.get(photo, 1.0) for photo in frames],
    )
    limited = map(pipeline.limit_accuracy, smoothed)
    return SmoothedSequence(found | dict(zip(frames, limited, strict=True)))


def by_time(photos: Sequence[Path], *, limits: PhotoLimits) -> tuple[tuple[Path, ...], dict[Path, float]]:
    """Sort photos by capture time.

    Returns:
        steps: Time since the previous photo, divided by the median of these times, as for `SequenceFilter`.

    Raises:
        UsageError: A photo has no time of capture.
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
    """Return the capture time in seconds; None for an unreadable photo, which localization reports later."""
    try:
        taken_at = read_facts(photo, limits=limits).taken_at
    except PhotoError:
        return None
    if taken_at is None:
        raise UsageError(
            f"{photo.name} has no capture time",
            where="--by-time",
            hint="name the photos in their order and leave --by-time out",
        )
    return datetime.fromisoformat(taken_at).replace(tzinfo=UTC).timestamp()
