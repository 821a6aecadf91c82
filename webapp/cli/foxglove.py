"""`expmap foxglove localize`: show answers in Foxglove, live or as an MCAP file."""

from __future__ import annotations

import io
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import click
import cv2
from PIL import Image

from webapp.cli import exitcodes
from webapp.cli.options import MAP_FILE, chosen_settings, fov_option, index_options, map_options, open_options
from webapp.cli.progressbar import terminal_progress
from webapp.core.hypotheses.jsonform import answer_to_json
from webapp.core.hypotheses.model import Answer, Hypothesis
from webapp.errors import PhotoError
from webapp.extras import require
from webapp.files.decode import PHOTO_SUFFIXES
from webapp.files.photos.photo import read_upright
from webapp.render.answer_pictures import map_picture, match_picture
from webapp.render.colours import probability_colour
from webapp.render.foxglove import FoxglovePoint, FoxgloveSink
from webapp.settings import keep_freed_memory
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.pipeline import LocalizationPipeline

_POLL_S = 1.0
"""Polling interval of folders."""

_SIDE_PX = 1600


def sink_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options for the output: an MCAP file, or the address of the server."""
    options = (
        click.option(
            "--out",
            type=click.Path(dir_okay=False, path_type=Path),
            metavar="FILE.mcap",
            help="Write a file instead of serving.",
        ),
        click.option(
            "--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Address to listen on."
        ),
        click.option(
            "--port",
            type=click.IntRange(0, 65535),
            default=8765,
            show_default=True,
            metavar="N",
            help="Port to listen on; 0 picks a free one.",
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


def serve_until_interrupted(sink: FoxgloveSink, host: str, *, poll: Callable[[], None]) -> None:
    """Print the server's address and call `poll` every second until Ctrl-C; call it once for a file."""
    if sink.port is None:
        poll()
        return
    stopped = threading.Event()

    def stop(*_: object) -> None:
        stopped.set()  # needed as Python ignores the exception if it is raised in a destructor
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, stop)
    try:
        click.echo(f"listening on ws://{host}:{sink.port}")
        while not stopped.is_set():
            poll()
            stopped.wait(_POLL_S)
    except KeyboardInterrupt:
        pass
    finally:
        signal.signal(signal.SIGINT, before)
    click.echo("stopped", err=True)


@click.command(short_help="Show answers with their pictures.")
@click.argument("map_file", metavar="MAP.cfg", type=MAP_FILE)
@click.argument(
    "photos", metavar="PHOTO...", type=click.Path(exists=True, path_type=Path), nargs=-1, required=True
)
@fov_option
@sink_options
@index_options
@map_options
def localize(
    map_file: Path,
    photos: tuple[Path, ...],
    out: Path | None,
    host: str,
    port: int,
    **chosen: Any,
) -> None:
    """Localize photos one after another, and show them with matches and hypotheses in Foxglove.

    All photos in a folder are used; when serving, also those added later.
    """
    require("foxglove")
    keep_freed_memory()
    with FoxgloveSink(out=out, address=(host, port)) as sink:
        with terminal_progress("photos") as progress:
            pipeline = open_pipeline(
                map_file,
                open_options(chosen),
                settings=chosen_settings(map_file, chosen),
                progress=progress,
                fov_deg=chosen["fov"],
            )
        watched = WatchedPhotos(photos)
        unusable: list[Path] = []

        def show_new() -> None:
            for photo in watched.new(settled=out is not None):
                if not _show(sink, photo, pipeline=pipeline):
                    unusable.append(photo)

        serve_until_interrupted(sink, host, poll=show_new)
    if out is not None and unusable:
        sys.exit(exitcodes.SOME_FAILED)


class WatchedPhotos:
    """Given photos, and those that appear in given folders."""

    def __init__(self, given: Iterable[Path]) -> None:
        self._given = tuple(given)
        self._seen: dict[Path, tuple[int, int]] = {}
        self._taken: set[Path] = set()

    def new(self, *, settled: bool) -> Iterator[Path]:
        """Yield each photo once: immediately if `settled`, else when it is unchanged since the last call."""
        for photo in self._inside():
            if photo in self._taken:
                continue
            try:
                state = photo.stat()
            except FileNotFoundError:  # a temporary file of a copy in progress, or removed
                continue
            now = (state.st_size, state.st_mtime_ns)
            if settled or self._seen.get(photo) == now:
                self._taken.add(photo)
                yield photo
            self._seen[photo] = now

    def _inside(self) -> Iterator[Path]:
        for path in self._given:
            if path.is_dir():
                yield from sorted(p for p in path.iterdir() if p.suffix.lower() in PHOTO_SUFFIXES)
            else:
                yield path


def _show(sink: FoxgloveSink, photo: Path, *, pipeline: LocalizationPipeline) -> bool:
    """Send a photo and its answer; returns whether the photo could be used."""
    cfg, the_map, limits = pipeline.cfg, pipeline.map, pipeline.settings.photo
    try:
        pixels = read_upright(photo, limits=limits, max_side=_SIDE_PX)
        answer = pipeline.localize(photo, top=5)
        matches = match_picture(cfg, the_map, query=photo, answer=answer, limits=limits)
    except PhotoError as error:
        click.echo(f"expmap: {error}", err=True)
        return False
    now = time.time()
    sink.image("/image", cv2.imencode(".jpg", pixels)[1].tobytes(), time_s=now)
    if matches is not None:
        sink.image("/matches", _jpeg(matches), time_s=now)
    sink.image("/map", _jpeg(map_picture(cfg, the_map, answer=answer, limits=limits)), time_s=now)
    sink.values("/answer", _form(pipeline, photo, answer=answer), time_s=now)
    if the_map.georeference is not None:
        points = [_point(h, pipeline) for h in answer.hypotheses]
        sink.points("/hypotheses", points, time_s=now)
        if not answer.abstained:
            sink.point("/position", points[0], time_s=now)
    return True


def _jpeg(picture: Image.Image) -> bytes:
    made = io.BytesIO()
    picture.convert("RGB").save(made, "JPEG", quality=88)
    return made.getvalue()


def _form(pipeline: LocalizationPipeline, photo: Path, *, answer: Answer) -> dict[str, Any]:
    return answer_to_json(answer, query=str(photo), source=pipeline.answer_source())


def _point(hypothesis: Hypothesis, pipeline: LocalizationPipeline) -> FoxglovePoint:
    georeference = pipeline.map.georeference
    if georeference is None:
        raise ValueError("the map has no georeference")
    covariance = None
    if hypothesis.radius_px is not None:
        variance = (hypothesis.radius_px * georeference.metres_per_pixel(hypothesis.position) / 1.51) ** 2
        covariance = (variance, variance, 0.0)
    return FoxglovePoint(
        georeference.latlon_of(hypothesis.position),
        probability_colour(hypothesis.probability),
        covariance_m2=covariance,
        heading_deg=hypothesis.heading_deg,
        about={"rank": str(hypothesis.rank), "probability": f"{hypothesis.probability:.3f}"},
    )
