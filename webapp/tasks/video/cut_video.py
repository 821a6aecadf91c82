"""Makes photos of a video: sharp, spread frames with the times and positions that were recorded."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

from webapp.core.geo.types import LatLon
from webapp.core.keyframes import KeyframeChooser, small_gray
from webapp.core.trajectory import FixTrack, Match, match
from webapp.errors import PhotoError, TrackError, UsageError
from webapp.files.exchange.gpx import SUFFIX as GPX
from webapp.files.exchange.gpx import parse_gpx
from webapp.files.photos.exif_write import CameraTags, write_view
from webapp.files.text_file import read_bytes
from webapp.files.video.clip import Clip, VideoFrame, open_clip
from webapp.files.video.subtitles import SUFFIX as SUBTITLES
from webapp.files.video.subtitles import read_subtitles
from webapp.progress import Progress
from webapp.settings import PhotoLimits

_PER_SECOND = 6.0
"""Frames that are compared: more would find hardly sharper ones."""

_MAX_GAP_S = 10.0
"""Longest time between two fixes over which positions are interpolated."""

_AT_PLACE_S = 2.0
"""A clip of a phone has only the place where it begins: photos of the first seconds get it."""

_DIAGONAL_35MM = math.hypot(36.0, 24.0)


@dataclass(frozen=True, slots=True)
class CutVideoOptions:
    """What is made of a video."""

    spread: float = 0.25  # How far the view moves between two photos, as a fraction of the width
    most: int = 1000  # Number of photos
    fov_deg: float | None = None  # Horizontal field of view, for the EXIF of the photos
    starts_s: float | None = None  # When the video begins, seconds since 1970; default: as it says
    track: Path | None = None  # SRT or GPX; default: in the video, or an SRT of the same name


@dataclass(frozen=True, slots=True)
class CutVideo:
    """The photos of a video, in order of time."""

    photos: tuple[str, ...]
    with_position: int  # How many of them have a position
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Recorded:
    """Where and when a clip was taken, as far as it is known; the times of the track begin with the clip."""

    track: FixTrack | None
    place: LatLon | None
    begins: datetime | None

    def tags(self, frame: VideoFrame, *, fov_deg: float | None) -> CameraTags:
        taken_at = None if self.begins is None else self.begins + timedelta(seconds=round(frame.at_s, 3))
        focal = None if fov_deg is None else _focal_35mm(frame, fov_deg)
        return CameraTags(taken_at, focal, self._position(frame.at_s))

    def _position(self, at_s: float) -> LatLon | None:
        if self.track is None:
            return self.place if at_s <= _AT_PLACE_S else None
        (found,) = match(self.track, [at_s], max_gap_s=_MAX_GAP_S)
        return found.position if isinstance(found, Match) else None


def cut_video(
    path: Path, out: Path, *, options: CutVideoOptions, limits: PhotoLimits, progress: Progress
) -> CutVideo:
    """Write the chosen frames as JPEG, named after the video and their time in it.

    A frame keeps its name when the video is cut again.

    Raises:
        PhotoError: The video cannot be read.
        TrackError: The track cannot be read, or the video does not say when it began.
        StorageError: A photo cannot be written.
    """
    with open_clip(path, limits=limits) as clip:
        recorded = _recorded(clip, path, options)
        progress.size(max(1, math.ceil(clip.seconds or 1.0)))
        chooser: KeyframeChooser[VideoFrame] = KeyframeChooser(spread=options.spread)
        photos: list[str] = []
        placed, done, notes = 0, 0, list[str]()

        def keep(frame: VideoFrame | None) -> None:
            nonlocal placed
            if frame is None:
                return
            name = f"{path.stem}_{round(frame.at_s * 1000):07}.jpg"
            tags = recorded.tags(frame, fov_deg=options.fov_deg)
            write_view(out / name, frame.pixels, tags=tags)
            placed += tags.position is not None
            photos.append(name)

        try:
            for frame in clip.frames(per_second=_PER_SECOND):
                progress.check()
                keep(chooser.offer(frame, small_gray(frame.pixels), at_s=frame.at_s))
                if len(photos) >= options.most:
                    notes.append(
                        f"{options.most} photos were made of its first {frame.at_s:.0f} seconds; "
                        "the rest is left out"
                    )
                    break
                progress.advance(int(frame.at_s) - done)
                done = int(frame.at_s)
            else:
                keep(chooser.finish())
        except PhotoError as error:
            if not photos:
                raise
            notes.append(error.message)
    if not photos:
        raise PhotoError("no frame of it can be read", where=str(path))
    others = len({found.name for found in out.glob(f"{path.stem}_???????.jpg")} - {*photos})
    if others:
        notes.append(f"{others} photos in the folder are from the same video, cut otherwise before")
    return CutVideo(tuple(photos), placed, tuple(notes))


def _recorded(clip: Clip, path: Path, options: CutVideoOptions) -> _Recorded:
    begins = _begins(clip, options.starts_s)
    given = options.track or next((p for p in path.parent.glob(f"{_plain(path.stem)}.*") if _is_srt(p)), None)
    if given is None:
        return _Recorded(clip.track(), clip.place, begins)
    if _is_srt(given):
        found = read_subtitles(given)
        return _Recorded(found.track, clip.place, begins or found.clock)
    if given.suffix.lower() != GPX:
        raise UsageError("a track of a video is an SRT or a GPX file", where=str(given))
    if begins is None:
        raise TrackError(
            "the video does not say when it began",
            where=str(path),
            hint="give --starts, such as 2026-05-01T10:00:00Z",
        )
    fixes = parse_gpx(read_bytes(given, error=TrackError))
    return _Recorded(FixTrack(fixes.times_s - begins.timestamp(), fixes.latlon), clip.place, begins)


def _begins(clip: Clip, given_s: float | None) -> datetime | None:
    begins_s = clip.begins_s if given_s is None else given_s
    if begins_s is None:
        return None
    zone = UTC if clip.zone_s is None else timezone(timedelta(seconds=clip.zone_s))
    return datetime.fromtimestamp(begins_s, zone)


def _is_srt(path: Path) -> bool:
    return path.suffix.lower() == SUBTITLES


def _plain(stem: str) -> str:
    """Escape what `glob` would take as a pattern."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in stem)


def _focal_35mm(frame: VideoFrame, fov_deg: float) -> int:
    height, width = frame.pixels.shape[:2]
    focal_px: float = width / 2.0 / math.tan(math.radians(fov_deg) / 2.0)
    focal = float(focal_px / math.hypot(width, height) * _DIAGONAL_35MM)
    return max(1, round(focal))
