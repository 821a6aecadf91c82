"""`expmap evaluate`: measure the accuracy of the answers."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from webapp.cli import exitcodes
from webapp.cli.build import report_failed
from webapp.cli.options import (
    MAP_FILE,
    check_sequence,
    chosen_settings,
    fov_option,
    index_options,
    map_options,
    open_options,
    sequence_options,
)
from webapp.cli.progressbar import terminal_progress
from webapp.core.hypotheses.model import Answer
from webapp.errors import UsageError
from webapp.files.localize import queries_csv
from webapp.render import report
from webapp.render.report import figures
from webapp.settings import PhotoLimits, keep_freed_memory
from webapp.tasks.evaluation import evaluate as task
from webapp.tasks.evaluation.evaluate import with_hidden_photos
from webapp.tasks.evaluation.types import EvaluateOptions, Evaluation
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.sequence import SequenceFilter, smooth_sequence


def summary_table(evaluation: Evaluation) -> str:
    """Format the figures as a table: name, value, 95 % interval.

    Returns:
        Lines, without a trailing newline.
    """
    lines = figures(evaluation)
    words, value = (
        max(len(text) for text in texts) for texts in ([f.words for f in lines], [f.value for f in lines])
    )
    body = [f"{f.words:<{words}}  {f.value:>{value}}  {f.interval}".rstrip() for f in lines]
    return "\n".join([heading(evaluation), "", *body])


def heading(evaluation: Evaluation) -> str:
    """Return a line that describes the evaluation."""
    subject = evaluation.subject
    asked = {
        "queries": f"{evaluation.summary.queries} queries",
        "leave-one-out": f"{evaluation.summary.queries} of its own photos, each hidden",
        "leave-one-place-out": f"{evaluation.summary.queries} of its own photos, "
        f"all within {evaluation.hide_within_px or 0:.0f} px hidden",
    }[evaluation.scheme]
    photos = len(subject.map.experiences)
    return f"{subject.method}, {subject.features}: map of {photos} photos, {asked}"


_QUERIES = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command()
@click.argument("map_file", metavar="MAP.cfg", type=MAP_FILE)
@click.argument("queries", metavar="[QUERIES.csv]", type=_QUERIES, required=False)
@click.option("--self", "of_itself", is_flag=True, help="Use the map's own photos, each hidden in turn.")
@click.option(
    "--hide-within",
    type=click.FloatRange(0.0),
    metavar="PX",
    help="With --self: hide all photos this near.  [default: once the photo alone, once its whole place]",
)
@click.option(
    "--limit", type=click.IntRange(1), metavar="N", help="Use only N queries, evenly spread over the list."
)
@click.option(
    "-o", "--output", type=click.Path(file_okay=False, path_type=Path), metavar="FOLDER",
    help="Write a report to this folder.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@click.option(
    "--seed",
    type=int,
    default=0,
    show_default=True,
    metavar="N",
    help="Random seed of the bootstrap intervals.",
)
@sequence_options
@index_options
@fov_option
@map_options
def evaluate(
    map_file: Path,
    queries: Path | None,
    of_itself: bool,
    hide_within: float | None,
    limit: int | None,
    output: Path | None,
    as_json: bool,
    seed: int,
    sequence: bool,
    speed: float | None,
    smooth: bool,
    **chosen: Any,
) -> None:
    """Measure the accuracy of the answers on photos whose positions are known.

    QUERIES.csv has lines path;x;y below a header, paths relative to it. The report is a web page with
    tables, charts and the worst queries, and the same as CSV, JSON and TUM poses.
    """
    if of_itself == (queries is not None):
        raise UsageError("give either QUERIES.csv or --self", where="evaluate")
    if hide_within is not None and not of_itself:
        raise UsageError("can only be used with --self", where="--hide-within")
    if sequence and of_itself:
        raise UsageError("can only be used with QUERIES.csv", where="--sequence")
    check_sequence(sequence, {"--speed": speed is not None, "--smooth": smooth})
    keep_freed_memory()
    settings = chosen_settings(map_file, chosen)
    options = EvaluateOptions(limit=limit, seed=seed, hide_within_px=hide_within, sequence=sequence)
    folder = map_file.parent
    with terminal_progress("queries") as progress:
        pipeline = open_pipeline(
            map_file, open_options(chosen), settings=settings, progress=progress, fov_deg=chosen["fov"]
        )
        for look in pipeline.looks:
            report_failed(look.opened.built)
        progress.note("queries")
        localize: Callable[..., Answer] = pipeline.localize
        if smooth and queries is not None:
            frames = [query.path for query in queries_csv.select(queries_csv.read(queries), limit)]
            localize = smooth_sequence(pipeline, frames, progress=progress, speed_px=speed).localize
        elif sequence:
            localize = SequenceFilter(pipeline, speed_px=speed).localize
        if queries is None:
            own = with_hidden_photos(pipeline)
            done = task.evaluate_self(own, map_folder=folder, options=options, progress=progress)
        else:
            done = [
                task.evaluate_queries(
                    pipeline,
                    queries,
                    map_folder=folder,
                    localize=localize,
                    options=options,
                    progress=progress,
                )
            ]
    for evaluation in done:
        _report(evaluation, output, several=len(done) > 1, limits=settings.photo)
    forms = [task.to_json(evaluation) for evaluation in done]
    if as_json:
        click.echo(json.dumps(forms if of_itself else forms[0]))
    else:
        click.echo("\n\n".join(summary_table(evaluation) for evaluation in done))
    failed = any(evaluation.summary.failed for evaluation in done)
    sys.exit(exitcodes.SOME_FAILED if failed else exitcodes.DONE)


def _report(evaluation: Evaluation, output: Path | None, *, several: bool, limits: PhotoLimits) -> None:
    for result in evaluation.results:
        if result.error:
            click.echo(f"expmap: {result.error}", err=True)
    if output is None:
        return
    folder = output / evaluation.scheme if several else output
    report.write_evaluation(evaluation, folder, limits=limits)
    click.echo(f"report: {folder / 'report.html'}", err=True)
