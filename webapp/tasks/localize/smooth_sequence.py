"""Says where the frames of a recorded sequence were taken, each by all frames before and after it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from webapp.core.hypotheses.bayes import truncate
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.sequence import smooth
from webapp.errors import PhotoError
from webapp.progress import Progress
from webapp.tasks.localize.photo import PhotoLocalizer, parts
from webapp.tasks.localize.sequence import FRAME_TOP, motion


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedLocalizer(PhotoLocalizer):
    """The answers about the frames of a sequence that is whole.

    Attributes
    ----------
    found : mapping of Path to Answer or PhotoError
        Of each frame.
    """

    found: Mapping[Path, Answer | PhotoError] = field(default_factory=dict)

    def localize(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        """Tell what is known of a frame.

        Raises
        ------
        PhotoError
            The photo could not be used.
        """
        found = self.found[photo_path]
        if isinstance(found, PhotoError):
            raise found
        return truncate(found, top)


def run(
    localizer: PhotoLocalizer,
    photos: Sequence[Path],
    *,
    progress: Progress,
    speed_px: float | None = None,
    steps: Mapping[Path, float] = MappingProxyType({}),
) -> SmoothedLocalizer:
    """Localize all frames, each by all others.

    Parameters
    ----------
    localizer : PhotoLocalizer
    photos : sequence of Path
        In the order in which they were taken.
    progress : Progress
        One step a photo.
    speed_px : float, optional
        Usual way from a frame to the next, map pixels.
    steps : mapping of Path to float
        Time since the frame before, in usual intervals, where it is not 1.

    Raises
    ------
    Cancelled
    """
    progress.size(len(photos))
    found: dict[Path, Answer | PhotoError] = {}
    for photo in photos:
        progress.check()
        try:
            found[photo] = localizer.look(photo, top=FRAME_TOP)
        except PhotoError as error:
            found[photo] = error
        progress.advance()
    frames = {photo: answer for photo, answer in found.items() if isinstance(answer, Answer)}
    smoothed = smooth(
        list(frames.values()),
        motion=motion(localizer, speed_px=speed_px),
        top=FRAME_TOP,
        steps=[steps.get(photo, 1.0) for photo in frames],
    )
    found |= dict(zip(frames, smoothed, strict=True))
    return SmoothedLocalizer(**parts(localizer), found=found)
