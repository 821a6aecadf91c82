"""`expmap map cut-panoramas`, `cut-video` and `join-panoramas`: photos of panoramas and videos."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from webapp.cli.exitcodes import SOME_FAILED
from webapp.cli.progressbar import terminal_progress
from webapp.configuration import load_settings
from webapp.errors import UsageError
from webapp.files.exchange.times import unix_time
from webapp.files.photos.panorama import read_rig
from webapp.files.video.clip import is_begin
from webapp.tasks.maps.panoramas import CutOptions, CutPhoto, JoinedPanorama, JoinOptions
from webapp.tasks.maps.panoramas import cut_panoramas as cut
from webapp.tasks.maps.panoramas import join_panoramas as join
from webapp.tasks.video.cut_video import CutVideoOptions
from webapp.tasks.video.cut_video import cut_video as photos_of_video

_FILE = click.Path(exists=True, dir_okay=False, path_type=Path)
_FOLDER = click.Path(file_okay=False, path_type=Path)
_ELEVATION = click.FloatRange(0.0, 90.0)


@click.command("cut-panoramas", short_help="Cut panoramas into level perspective views.")
@click.argument("folder", metavar="FOLDER", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("-o", "--out", required=True, type=_FOLDER, metavar="FOLDER", help="Where the views go.")
@click.option(
    "--views", default=6, show_default=True, type=click.IntRange(1, 36), metavar="N",
    help="Number of views per panorama, evenly spaced all around.",
)  # fmt: skip
@click.option(
    "--lowest", default=90.0, show_default=True, type=_ELEVATION, metavar="DEGREES",
    help="Mask everything farther below the horizon: the robot or the tripod.",
)  # fmt: skip
@click.option(
    "--highest", default=90.0, show_default=True, type=_ELEVATION, metavar="DEGREES",
    help="Mask everything farther above it: the sky.",
)  # fmt: skip
@click.option(
    "--assume",
    is_flag=True,
    help="Also cut photos twice as wide as high that have no panorama metadata (XMP).",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def cut_panoramas(
    ctx: click.Context,
    folder: Path,
    out: Path,
    views: int,
    lowest: float,
    highest: float,
    assume: bool,
    as_json: bool,
) -> None:
    """Cut the panoramas of a folder into level perspective views of 91 degrees.

    A view has the panorama's position, accuracy and time, its own heading if that of the panorama is known,
    and a focal length: it is a photo like any other. Panoramas are equirectangular, as made by cameras and
    street-level services. Exit code 1 when a photo could not be cut.
    """
    options = CutOptions(views, lowest_deg=lowest, highest_deg=highest, assume=assume)
    with terminal_progress("photos") as progress:
        done = list(cut(folder, out, options=options, limits=load_settings().photo, progress=progress))
    click.echo(json.dumps([_as_json(one) for one in done]) if as_json else "\n".join(map(_line, done)))
    failed = sum(bool(one.problem) for one in done)
    click.echo(f"{out}: {len(done) - failed} of {len(done)} photos cut", err=True)
    if failed:
        ctx.exit(SOME_FAILED)


def _as_json(one: CutPhoto) -> dict[str, object]:
    return asdict(one) | {"problem": one.problem or None}


def _line(one: CutPhoto) -> str:
    return f"{one.photo}  {one.problem or f'{len(one.views)} views'}"


@click.command("join-panoramas", short_help="Join photos from several cameras into panoramas.")
@click.argument("folder", metavar="FOLDER", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option(
    "--rig", required=True, type=click.Path(dir_okay=False, path_type=Path), metavar="RIG.json",
    help="How the cameras are mounted, and which photos are theirs.",
)  # fmt: skip
@click.option("-o", "--out", required=True, type=_FOLDER, metavar="FOLDER", help="Where the panoramas go.")
@click.option(
    "--mask", type=click.Path(dir_okay=False, path_type=Path), metavar="MASK.png",
    help="Write a mask of what no camera sees, for all panoramas.",
)  # fmt: skip
@click.option(
    "--width", type=click.IntRange(64), metavar="PX",
    help="Width of the panoramas; default: as many pixels per degree as the photos.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def join_panoramas(
    ctx: click.Context,
    folder: Path,
    rig: Path,
    out: Path,
    mask: Path | None,
    width: int | None,
    as_json: bool,
) -> None:
    """Join the photos that the cameras of a robot took at one instant into one panorama.

    It gets the time, position and heading of the photos. It can be interrupted at any time; panoramas that
    already exist are not made again. Exit code 1 when photos could not be joined.
    """
    cameras, settings = read_rig(rig), load_settings()
    with terminal_progress("panoramas") as progress:
        options = JoinOptions(width, mask)
        done = list(
            join(folder, out, cameras=cameras, options=options, limits=settings.photo, progress=progress)
        )
    if as_json:
        click.echo(json.dumps([asdict(one) | {"problem": one.problem or None} for one in done]))
    else:
        click.echo("\n".join(map(_joined_line, done)))
    failed = sum(bool(one.problem) for one in done)
    click.echo(f"{out}: {len(done) - failed} of {len(done)} panoramas", err=True)
    if failed:
        ctx.exit(SOME_FAILED)


def _joined_line(one: JoinedPanorama) -> str:
    return f"{one.panorama}  {one.problem or ('joined' if one.is_new else 'already there')}"


@click.command("cut-video", short_help="Make photos of the sharp, spread frames of a video.")
@click.argument("video", metavar="VIDEO", type=_FILE)
@click.option("-o", "--out", required=True, type=_FOLDER, metavar="FOLDER", help="Where the photos go.")
@click.option(
    "--track", type=_FILE, metavar="FILE",
    help="Its positions: SRT of a drone, or GPX; default: in the video (GoPro), or an SRT of the same name.",
)  # fmt: skip
@click.option(
    "--starts", metavar="TIME",
    help="When it begins, such as 2026-05-01T10:00:00Z; default: as the video says.",
)  # fmt: skip
@click.option(
    "--spread", default=25.0, show_default=True, type=click.FloatRange(2.0, 100.0), metavar="PERCENT",
    help="How far the view moves between two photos, in percent of its width.",
)  # fmt: skip
@click.option(
    "--most", default=1000, show_default=True, type=click.IntRange(1), metavar="N", help="Number of photos."
)
@click.option(
    "--fov", type=click.FloatRange(1.0, 179.0), metavar="DEGREES",
    help="Horizontal field of view, to be written into the photos.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def cut_video(
    video: Path,
    out: Path,
    track: Path | None,
    starts: str | None,
    spread: float,
    most: int,
    fov: float | None,
    as_json: bool,
) -> None:
    """Make photos of a video, for a map or as queries: where the view has moved on, the sharpest frame.

    They have the time, and where it was recorded the position, in their EXIF; `expmap map from-photos` makes
    a map of them. Those without a position are placed with the others, as any photos. Run it again after an
    interruption: the same frames are chosen, and written again.
    """
    options = CutVideoOptions(spread / 100.0, most, fov, _moment(starts), track)
    with terminal_progress("seconds") as progress:
        done = photos_of_video(video, out, options=options, limits=load_settings().photo, progress=progress)
    if as_json:
        click.echo(json.dumps(asdict(done)))
        return
    for note in done.notes:
        click.echo(f"{video}: {note}", err=True)
    click.echo(f"{out}: {len(done.photos)} photos, {done.with_position} with a position")


def _moment(text: str | None) -> float | None:
    if text is None:
        return None
    moment = unix_time(text)
    if not is_begin(moment):
        raise UsageError(f"{text!r} is not a time", where="--starts", hint="such as 2026-05-01T10:00:00Z")
    return moment
