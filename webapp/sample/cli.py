"""`expmap sample`: make a small map to try things on."""

from __future__ import annotations

from pathlib import Path

import click

from webapp.cli.library import library_option, library_settings
from webapp.cli.progressbar import terminal_progress
from webapp.sample import make


@click.command("sample")
@click.argument("folder", required=False, type=click.Path(path_type=Path))
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=7,
    show_default=True,
    metavar="N",
    help="Random seed of the synthetic park.",
)
@click.option("--force", is_flag=True, help="Replace an existing sample.")
@library_option
def sample(folder: Path | None, seed: int, force: bool, library: Path | None) -> None:
    """Make a small map of a synthetic park, with photos to localize.

    Writes to FOLDER, or to `sample` in the library, and prints the path of its map.
    """
    settings = library_settings(library)
    with terminal_progress("photos") as progress:
        report = make.make_sample(folder, settings=settings, progress=progress, seed=seed, force=force)
    if not report.made:
        click.echo("the sample already exists", err=True)
    click.echo(report.cfg_path)
