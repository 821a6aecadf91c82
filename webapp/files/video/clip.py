"""Reads the frames and metadata of a video (PyAV, which is FFmpeg: any usual container and codec)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon
from webapp.core.trajectory import FixTrack, make_track
from webapp.errors import PhotoError
from webapp.extras import extra
from webapp.files.exchange.times import unix_time
from webapp.files.video.gpmf import GpmfError, is_telemetry, read_positions
from webapp.settings import PhotoLimits

SUFFIXES = (".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm", ".mts", ".3gp")
"""Of files that people take for videos; what is in them decides."""

_STARTS = ("com.apple.quicktime.creationdate", "creation_time")
"""Keys of the time when a clip begins: that of Apple has the local time zone."""

_PLACES = ("com.apple.quicktime.location.ISO6709", "location")
_ISO6709 = re.compile(r"([+-]\d+(?:\.\d+)?)([+-]\d+(?:\.\d+)?)")
_BEGIN, _END = unix_time("1971-01-01"), unix_time("2200-01-01")
"""When videos are taken: cameras whose clock is not set write a time before it."""

_DAY_S = 86_400.0

_MOST_TELEMETRY = 100_000_000
"""Bytes of the telemetry of a clip."""


class VideoFrame(NamedTuple):
    """A frame, upright: pixels (h, w, 3) uint8 in the order of OpenCV, and seconds since the clip's begin."""

    pixels: NDArray[np.uint8]
    at_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """A video that is open."""

    seconds: float | None  # Its length; None if it does not say
    begins_s: float | None  # When it begins, seconds since 1970, UTC; None if it does not say
    zone_s: float | None  # Offset of the local time from UTC, seconds; None if unknown
    place: LatLon | None  # Where it begins; phones store only that
    _container: Any
    _stream: Any
    _limits: PhotoLimits

    def frames(self, *, per_second: float) -> Iterator[VideoFrame]:
        """Decode frames, at most so many a second.

        Raises:
            PhotoError: The video is damaged, or its frames become too large; those before were yielded.
        """
        with extra("video"):
            import av
        begin, last = None, -math.inf
        try:
            for frame in self._container.decode(self._stream):
                if frame.time is None:
                    continue
                begin = float(frame.time) if begin is None else begin
                at_s = float(frame.time) - begin
                if at_s - last < 1.0 / per_second - 1e-3:
                    continue
                last = at_s
                _check_size(frame.width, frame.height, limits=self._limits)  # the header need not be right
                yield VideoFrame(_upright(frame), at_s)
        except av.error.FFmpegError as error:
            raise PhotoError(f"the video is damaged: {error.strerror}", hint="copy it again") from error

    def track(self) -> FixTrack | None:
        """Read the positions that a GoPro stores in the clip; None if there are none.

        Its times are seconds since the begin of the clip. Raises PhotoError if they are damaged.
        """
        for stream in self._container.streams.data:
            first = next((bytes(packet) for packet in self._container.demux(stream) if packet.size), b"")
            self._container.seek(0)
            if is_telemetry(first):
                return self._gopro(stream)
        return None

    def _gopro(self, stream: Any) -> FixTrack | None:
        times: list[float] = []
        positions: list[LatLon] = []
        size = 0
        try:
            for packet in self._container.demux(stream):
                if not packet.size or packet.pts is None:
                    continue
                size += packet.size
                if size > _MOST_TELEMETRY:
                    raise PhotoError("the telemetry of the video is too large", hint="cut the video first")
                fixes = read_positions(bytes(packet))
                begin, length = (
                    float(value * packet.time_base) for value in (packet.pts, packet.duration or 0)
                )
                # the fixes of a packet are spread evenly over its duration
                times += [begin + length * number / len(fixes) for number in range(len(fixes))]
                positions += fixes
        except GpmfError as error:
            raise PhotoError(f"the telemetry of the video is damaged: {error}") from error
        finally:
            self._container.seek(0)
        kept = [n for n, place in enumerate(positions) if not math.isnan(place.lat)]
        return make_track([times[n] for n in kept], [positions[n] for n in kept]) if kept else None


def is_begin(moment_s: float) -> bool:
    """Return whether a video may begin at a time, seconds since 1970; not at NaN."""
    return _BEGIN < moment_s < _END


@contextmanager
def open_clip(path: Path, *, limits: PhotoLimits) -> Iterator[Clip]:
    """Open a video.

    Raises:
        PhotoError: It is missing, not a video, or its frames are too large.
        MissingPart: The extra `video` is not installed.
    """
    with extra("video"):
        import av
    try:
        container = av.open(str(path), options={"protocol_whitelist": "file"})
    except (av.error.FFmpegError, OSError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise PhotoError(f"it is not a video that can be read: {reason}", where=str(path)) from error
    with container:
        if not container.streams.video:
            raise PhotoError("it has no pictures", where=str(path), hint="is it a sound file?")
        stream = container.streams.video[0]
        _check_size(stream.codec_context.width, stream.codec_context.height, limits=limits, where=str(path))
        stream.thread_type = "AUTO"
        yield _described(container, stream, limits)


def _check_size(width: int, height: int, *, limits: PhotoLimits, where: str = "") -> None:
    megapixels = width * height / 1e6
    if megapixels > limits.max_megapixels:
        raise PhotoError(
            f"its frames have {megapixels:.0f} megapixels, more than {limits.max_megapixels:g}",
            where=where,
            hint="make it smaller, or raise photo.max_megapixels",
        )


def _described(container: Any, stream: Any, limits: PhotoLimits) -> Clip:
    facts = {**stream.metadata, **container.metadata}
    text = next((facts[key] for key in _STARTS if key in facts), "")
    begins_s = unix_time(text)
    zone = re.search(r"([+-])(\d\d):?(\d\d)$", text)
    zone_s = (1 if zone[1] == "+" else -1) * (3600.0 * int(zone[2]) + 60.0 * int(zone[3])) if zone else None
    if zone_s is not None and abs(zone_s) >= _DAY_S:
        zone_s = None
    found = next((m for key in _PLACES if (m := _ISO6709.match(facts.get(key, "")))), None)
    place = LatLon(float(found[1]), float(found[2])) if found else None
    if place is not None and not (abs(place.lat) <= 90.0 and abs(place.lon) <= 180.0):
        place = None
    seconds = container.duration / 1e6 if container.duration else None
    return Clip(seconds, begins_s if is_begin(begins_s) else None, zone_s, place, container, stream, limits)


def _upright(frame: Any) -> NDArray[np.uint8]:
    pixels: NDArray[np.uint8] = frame.to_ndarray(format="bgr24")
    turns = round(getattr(frame, "rotation", 0) / 90) % 4
    return np.ascontiguousarray(np.rot90(pixels, turns)) if turns else pixels
