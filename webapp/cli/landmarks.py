"""`expmap landmarks build` and `tags`: reconstruct the photos of a map; print tags to mount in the world."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.options import MAP_FILE
from webapp.cli.progressbar import terminal_progress
from webapp.core.mapmodel.control_points import TAG_FAMILIES
from webapp.errors import UsageError
from webapp.files.atomic import write_bytes
from webapp.files.maps.folder import read_map
from webapp.render.sheet.options import PAPERS, Paper
from webapp.render.sheet.tags import TagSheet, numbers_of, print_tags
from webapp.settings import keep_freed_memory
from webapp.tasks.landmarks.adjust import AdjustedSubmodel, adjust_submodels
from webapp.tasks.landmarks.colours import colour_cloud
from webapp.tasks.landmarks.reconstruct import Reconstruction, reconstruct
from webapp.tasks.landmarks.stored import export_models, names_of_photos


@click.command(short_help="Build the landmarks of a map by structure from motion.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.option(
    "-o", "--out", type=click.Path(path_type=Path), metavar="FOLDER",
    help="Write the models for other programs: COLMAP's text files, and the points as PLY.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def build(cfg: Path, out: Path | None, as_json: bool) -> None:
    """Join the photos of a map, including those in the tray, into pieces, and place these on the map.

    Only new photos are described and compared. It can be interrupted at any time; the next run continues
    where this one stopped.
    """
    keep_freed_memory()
    started = time.perf_counter()
    with terminal_progress("photos") as progress:
        the_map = read_map(cfg)
        settings = settings_in_use(cfg)
        found = reconstruct(cfg, the_map, settings=settings, progress=progress)
        found, adjusted = adjust_submodels(found, the_map, progress=progress)
        colour_cloud(cfg, found, limits=settings.photo, progress=progress)
    models = [] if out is None else export_models(found.folder, out, names=names_of_photos(found))
    joined = sum(len(submodel) for submodel in found.submodels)
    if as_json:
        submodels = [[found.photos[n].id for n in submodel.photo.tolist()] for submodel in found.submodels]
        failed = [{"id": found.photos[n].id, "reason": why} for n, why in sorted(found.problems.items())]
        written = [{"folder": str(m.folder), "photos": m.photos, "points": m.points} for m in models]
        seconds = round(time.perf_counter() - started, 3)
        result = {"photos": len(found.photos), "pieces": submodels, "failed": failed, "models": written}
        result["adjusted"] = [_as_json(submodel, found) for submodel in adjusted]
        click.echo(json.dumps(result | {"seconds": seconds}))
    else:
        sizes = ", ".join(str(len(submodel)) for submodel in found.submodels) or "none"
        click.echo(f"{joined} of {len(found.photos)} photos joined; photos of each piece: {sizes}")
        for outcome, photos in _outcomes(adjusted).items():
            click.echo(f"{photos} photos {outcome}")
        for model in models:
            click.echo(f"{model.folder}: {model.photos} photos, {model.points} points")
    for number, reason in sorted(found.problems.items()):
        click.echo(f"{found.photos[number].photo} (id {found.photos[number].id}): {reason}", err=True)


@click.command(short_help="Print tags that are recognised in photos, as PDF.")
@click.argument("out", metavar="OUT.pdf", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--family", type=click.Choice([*TAG_FAMILIES]), default="36h11", show_default=True,
    help="36h11 is AprilTag's, the others are ArUco's.",
)  # fmt: skip
@click.option("--ids", default="0-5", show_default=True, metavar="IDS", help="Such as 0-11,20.")
@click.option(
    "--size", type=float, default=150.0, show_default=True, metavar="MM", help="Side of the black square."
)
@click.option(
    "--paper", type=click.Choice(PAPERS), default="a4", show_default=True, help="Size of the paper."
)
def tags(out: Path, family: str, ids: str, size: float, paper: Paper) -> None:
    """Print tags to mount on walls or on the floor: with id and size below each, and a line of 100 mm.

    Print without scaling, and measure the line. Once the tags are control points of a map (expmap landmarks
    points), photos that show them are localized by them.
    """
    if out.suffix.lower() != ".pdf":
        raise UsageError("the name of the file must end with .pdf", where=str(out))
    numbers = numbers_of(ids, family=family)
    write_bytes(out, print_tags(TagSheet(family, numbers, size, paper)))
    click.echo(f"{out}: {len(numbers)} tags of {size:g} mm")


def _as_json(submodel: AdjustedSubmodel, found: Reconstruction) -> dict[str, object]:
    """Return the result of a submodel's adjustment; its known positions are sorted by falling residual."""
    anchors = [
        {"id": found.photos[n].id, "photo": found.photos[n].photo, "residual_px": round(residual, 2)}
        for n, residual in sorted(submodel.residual_px.items(), key=lambda pair: -pair[1])
    ]
    return {"photos": len(submodel.photos), "problem": submodel.problem or None, "anchors": anchors}


def _outcomes(adjusted: Iterable[AdjustedSubmodel]) -> Counter[str]:
    """Count the adjusted photos, and the others by reason."""
    counted: Counter[str] = Counter()
    for submodel in adjusted:
        outcome = f"as they were: {submodel.problem}" if submodel.problem else "on the map"
        counted[outcome] += len(submodel.photos)
    return counted
