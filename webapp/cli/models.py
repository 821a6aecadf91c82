"""`expmap models`: list, fetch and try the weights of networks."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from webapp.cli.progressbar import terminal_progress
from webapp.configuration import load_settings
from webapp.core.features.entry import ModelFile
from webapp.files.localize.models import MODELS, install_hint, models_folder
from webapp.tasks.operate import models as task
from webapp.tasks.operate.models import ModelCheck, check_models


@click.command("list")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def list_models(as_json: bool) -> None:
    """List the models and whether they are installed.

    Any one of a model's files is enough: they hold the same weights. A global descriptor is tested.
    """
    settings = load_settings()
    states = task.states(settings)
    if as_json:
        click.echo(json.dumps([asdict(state) for state in states]))
        return
    click.echo(f"folder: {models_folder(settings.models)}", err=True)
    for state in states:
        why = f": {state.problem}" if state.problem else ""
        click.echo(f"{state.model}: {_line(state.file)}; {state.state}{why}")
    if advice := task.advice(settings):
        click.echo(advice, err=True)


@click.command()
@click.argument("names", metavar="[MODEL]...", nargs=-1)
@click.option(
    "--from", "source", type=click.Path(exists=True, file_okay=False, path_type=Path), metavar="FOLDER",
    help="Copy the files from this folder instead of downloading them.",
)  # fmt: skip
def fetch(names: tuple[str, ...], source: Path | None) -> None:
    """Fetch all models, or those named, into EXPMAP_MODELS or the user's cache.

    A file is kept only if it is identical to the published one. Models without a published file you have to
    put there yourself.
    """
    settings = load_settings()
    missing = task.missing(names, settings=settings)
    wanted = missing if names else [name for name in missing if task.is_available(name, source)]
    if not missing:
        click.echo("all models are already installed", err=True)
    for name in missing[:1] if source and not wanted else wanted:
        file = task.choose_file(name, source)
        click.echo(f"{_line(file)}; from {source or file.address}", err=True)
        with terminal_progress(file.name) as progress:
            click.echo(task.fetch(file, source, settings=settings, progress=progress))
    for name in missing:
        if name not in wanted:
            click.echo(f"{name}: not fetched; {install_hint(MODELS[name][0])}", err=True)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def check(as_json: bool) -> None:
    """Try each installed model on a pair of pictures, which the program draws.

    Prints the matches, how many of them agree with the known warp between both (inliers), and the time. The
    exit code is 1 if a model cannot be used.
    """
    checks = [*check_models(load_settings())]
    if as_json:
        click.echo(json.dumps([asdict(one) for one in checks]))
    else:
        for one in checks:
            click.echo(f"{one.model}: {_result(one)}")
        if not checks:
            click.echo("no model is installed; run expmap models fetch", err=True)
    if any(one.problem for one in checks):
        raise SystemExit(1)


def _result(one: ModelCheck) -> str:
    if one.milliseconds is None:
        return f"unusable: {one.problem}"
    found = "" if one.inliers is None else f"{one.inliers} inliers of {one.matches} matches, "
    return f"{found}{one.milliseconds:.0f} ms"


def _line(file: ModelFile) -> str:
    if not file.published:
        return f"{file.name}, to be supplied by you: no published file is pinned, {file.source}"
    return f"{file.name}, {file.bytes / 1e6:.1f} MB, {file.licence}, {file.source}"
