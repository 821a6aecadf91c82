"""`expmap map cut-panoramas` and `join-panoramas`: cut panoramas into views, and join photos to panoramas."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from webapp.cli.exitcodes import SOME_FAILED
from webapp.cli.progressbar import terminal_progress
from webapp.configuration import load_settings
from webapp.files.photos.panorama import read_rig
from webapp.tasks.maps.panoramas import CutOptions, CutPhoto, JoinedPanorama, JoinOptions
from webapp.tasks.maps.panoramas import cut_panoramas as cut
from webapp.tasks.maps.panoramas import join_panoramas as join

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
@click.option("--json", "as_json", is_flag=True, help="Print one JSON array.")
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
@click.option("--json", "as_json", is_flag=True, help="Print one JSON array.")
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
