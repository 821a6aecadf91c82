"""`expmap map blur`: find and blur faces and number plates in the photos of a map."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.options import MAP_FILE
from webapp.cli.progressbar import terminal_progress
from webapp.files.localize.models import blur_networks
from webapp.tasks.blur.find import BlurReport, accept_in_folder, accept_in_library, photos_of, search_photos
from webapp.tasks.landmarks.accept import library_of

_KINDS = {"face": "face", "plate": "number plate"}


@click.command(short_help="Find faces and number plates in the photos, and blur them.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.option("--accept", is_flag=True, help="Blur what is found.")
@click.option(
    "--least-score", type=click.FloatRange(0.0, 1.0), default=0.0, metavar="SCORE",
    help="Leave out detections with a lower score, from 0 to 1.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.pass_context
def blur(ctx: click.Context, cfg: Path, accept: bool, least_score: float, as_json: bool) -> None:
    """Find faces and number plates in the photos of a map that are not blurred yet.

    The networks have to be installed first: expmap models fetch faces plates. Nothing is changed without
    --accept, and original files never are. It can be interrupted at any time; the next run searches only
    the remaining photos.
    """
    settings = settings_in_use(cfg)
    networks = blur_networks(settings.models)
    for model in networks.missing:
        click.echo(f"{model} will not be searched for: expmap models fetch {model}", err=True)
    blurred: list[int] = []
    with library_of(cfg, settings=settings) as there:
        with terminal_progress("photos") as progress:
            report = search_photos(
                cfg,
                photos_of(cfg),
                networks=networks,
                limits=settings.photo,
                progress=progress,
                least_score=least_score,
            )
        failed = list(report.failed)
        if accept and there is None:
            blurred = accept_in_folder(cfg, report.suggested)
        elif accept and there is not None:
            library, map_id = there
            with terminal_progress("photos blurred") as progress:
                blurred, refused = accept_in_library(
                    library, map_id, suggested=report.suggested, settings=settings, progress=progress
                )
            failed += refused
    if as_json:
        click.echo(json.dumps(_as_json(report, blurred, networks.missing)))
    else:
        _show(cfg, report, blurred=blurred, accept=accept)
    for one in failed:
        click.echo(f"{one.photo} (id {one.id}): {one.reason}", err=True)
    if failed:
        ctx.exit(1)


def _as_json(report: BlurReport, blurred: list[int], missing: tuple[str, ...]) -> dict[str, Any]:
    photos = [
        {
            "id": one.id,
            "photo": one.photo,
            "boxes": [{**d.box._asdict(), "kind": d.kind, "score": round(d.score, 3)} for d in one.boxes],
            "blurred": one.id in blurred,
        }
        for one in report.suggested
    ]
    failed = [{"id": one.id, "photo": one.photo, "reason": one.reason} for one in report.failed]
    return {"searched": report.searched, "photos": photos, "failed": failed, "missing": list(missing)}


def _show(cfg: Path, report: BlurReport, *, blurred: list[int], accept: bool) -> None:
    for one in report.suggested:
        found = ", ".join(f"{_KINDS[d.kind]} {d.score:.0%}" for d in one.boxes)
        click.echo(f"{one.photo}: {found}")
    boxes = sum(len(one.boxes) for one in report.suggested)
    done = f"; {len(blurred)} photos blurred" if accept else ", nothing changed"
    click.echo(
        f"{cfg}: {boxes} found in {len(report.suggested)} of {report.searched} photos searched{done}",
        err=True,
    )
