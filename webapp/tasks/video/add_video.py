"""Photos of an uploaded video are added to a map of the library.

The files wait in a folder of their own, named by a token. What was done is kept there, so that a run that was
killed is continued: the frames are chosen alike, and photos that the map has are duplicates.
"""

from __future__ import annotations

import json
import re
import shutil
import time
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath

from sqlalchemy import select

from webapp.errors import NotFound, PhotoError
from webapp.files.atomic import write_bytes, write_text
from webapp.files.exchange.gpx import SUFFIX as GPX
from webapp.files.part_file import check_space, discard, move_in
from webapp.files.video.clip import SUFFIXES
from webapp.files.video.subtitles import SUFFIX as SUBTITLES
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.operate.jobs import LIVE
from webapp.store.schema import Job
from webapp.tasks.maps.add_photo import Changing, IncomingPhoto, add_photo, tidy_name
from webapp.tasks.video.cut_video import CutVideo, CutVideoOptions, cut_video

JOB = "video-photos"
"""Kind of the job."""

_CUT, _PHOTOS = "cut.json", "photos"
_MOST_STEM = 60


@dataclass(frozen=True, slots=True)
class WaitingVideo:
    """A video in its waiting folder, and what is made of it."""

    clip: Path
    options: CutVideoOptions


@dataclass(frozen=True, slots=True)
class AddedVideo:
    cut: CutVideo
    added: int
    duplicates: int  # Photos that the map had
    failed: tuple[tuple[str, str], ...]  # Names of photos, and why they were not added


def is_clip(name: str) -> bool:
    return name.lower().endswith(SUFFIXES)


def is_track(name: str) -> bool:
    return name.lower().endswith((GPX, SUBTITLES))


def waiting_folder(library: Library, token: str) -> Path:
    """Return the folder of a video that waits for its job.

    Args:
        token: Hexadecimal digits.
    """
    return library.inner / "videos" / f"{int(token, 16):032x}"


def take(library: Library, token: str, *, part: Path, name: str) -> str:
    """Move a complete upload to the waiting folder, under a tidy name, which is returned.

    Raises DiskFull, StorageError.
    """
    own = PurePosixPath(tidy_name(name).replace("\\", "/"))
    stem = re.sub(r"[^\w-]+", "_", own.stem)[:_MOST_STEM].strip("_") or "video"
    tidy = stem + own.suffix.lower()
    move_in(part, waiting_folder(library, token) / tidy)
    return tidy


def add_video(
    library: Library,
    map_id: int,
    *,
    video: WaitingVideo,
    settings: Settings,
    progress: Progress,
    changing: Changing,
) -> AddedVideo:
    """Cut a video that waits, and add its photos to a map; its folder is deleted at the end.

    Raises:
        PhotoError, TrackError: The video or its track cannot be read.
        NotFound: The video, or the map, is gone.
        MissingPart: The extra `video` is not installed.
        DiskFull, StorageError
    """
    folder = video.clip.parent
    if not video.clip.is_file():
        raise NotFound("the uploaded video no longer exists", hint="upload it again")
    folder.touch()
    check_space(folder, 0, reserve_mb=settings.upload.reserve_mb)
    cut = _cut(video, settings=settings, progress=progress)
    progress.note("adding the photos")
    progress.size(len(cut.photos))
    added = duplicates = 0
    failed: list[tuple[str, str]] = []
    for name in cut.photos:
        progress.check()
        file = folder / _PHOTOS / name
        if not file.is_file():  # it was added before this run was interrupted
            duplicates += 1
            progress.advance()
            continue
        copy = folder / name  # it is moved before its record is committed
        write_bytes(copy, file.read_bytes())
        try:
            added_photo = add_photo(
                library,
                map_id,
                photo=IncomingPhoto(copy, name),
                settings=settings,
                changing=changing,
            )
            duplicates += added_photo.duplicate
            added += not added_photo.duplicate
            discard(file)
        except PhotoError as error:
            failed.append((name, error.message))
        progress.advance()
    shutil.rmtree(folder, ignore_errors=True)
    return AddedVideo(cut, added, duplicates, tuple(failed))


def _cut(video: WaitingVideo, *, settings: Settings, progress: Progress) -> CutVideo:
    """Cut the video, unless an interrupted run has."""
    done = video.clip.parent / _CUT
    if done.is_file():
        stored = json.loads(done.read_text("utf-8"))
        return CutVideo(tuple(stored["photos"]), stored["with_position"], tuple(stored["notes"]))
    photos = video.clip.parent / _PHOTOS
    shutil.rmtree(photos, ignore_errors=True)
    photos.mkdir()
    progress.note("choosing frames of the video")
    cut = cut_video(video.clip, photos, options=video.options, limits=settings.photo, progress=progress)
    write_text(done, json.dumps(asdict(cut)))
    return cut


def sweep(library: Library, settings: Settings) -> None:
    """Delete folders older than `upload.keep_hours` whose job is neither queued nor running."""
    with library.database.read() as session:
        live = session.scalars(select(Job.arguments).where(Job.kind == JOB, Job.state.in_(LIVE))).all()
    kept = {waiting_folder(library, asked["token"]) for asked in live}
    oldest = time.time() - 3600.0 * settings.upload.keep_hours
    for folder in (library.inner / "videos").glob("*"):
        if folder not in kept and folder.stat().st_mtime < oldest:
            shutil.rmtree(folder, ignore_errors=True)
