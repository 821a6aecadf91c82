"""Options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from webapp.cli.composition import settings_in_use
from webapp.configuration import settings_table
from webapp.core.features.table import BUNDLES, DETECTORS, EXTRACTORS, MATCHERS, METHODS
from webapp.core.hypotheses.places import MAP_KINDS
from webapp.errors import UsageError
from webapp.settings import Settings
from webapp.tasks.localize.plan import OpenOptions

Command = Callable[..., Any]
Decorator = Callable[[Command], Command]

MAP_FILE = click.Path(path_type=Path)
"""Existence is not checked here: a missing map is a map error, not a usage error."""


def area_option(name: str, *, sides: str, text: str) -> Decorator:
    """Make an option that takes the sides of an area as four comma-separated numbers."""
    return click.option(name, callback=_four_numbers, metavar=sides, help=text)


def _four_numbers(_ctx: click.Context, option: click.Parameter, text: str | None) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 4 or not all(map(math.isfinite, numbers)):
        raise click.BadParameter(f"write {option.metavar}: four numbers separated by commas")
    return numbers


def index_options(command: Command) -> Command:
    """Add the options that choose the index, and how it is built."""
    for option in reversed(_INDEX_OPTIONS):
        command = option(command)
    return command


def map_options(command: Command) -> Command:
    """Add options about a map: its photos' field of view and kind of positions, the tolerance of answers."""
    for option in reversed(_MAP_OPTIONS):
        command = option(command)
    return command


def fov_option(command: Command) -> Command:
    """Add the option for the field of view of the queries."""
    return click.option(
        "--fov",
        type=_ANGLE,
        metavar="DEGREES",
        help="Horizontal field of view of the upright query.  [default: its EXIF]",
    )(command)


def _limited(option: str, key: str, *, metavar: str, text: str) -> Decorator:
    """Make an option that overrides a setting."""
    setting = settings_table()[key]
    least = int(setting.minimum.value) if setting.minimum else 1
    help_text = f"{text}  [default: {setting.variables[0]}, or {setting.default}]"
    return click.option(option, type=click.IntRange(least), metavar=metavar, help=help_text)


_BUDGET = settings_table()["retrieval.budget_s"]

_INDEX_OPTIONS: list[Decorator] = [
    click.option(
        "--features",
        default="auto",
        show_default=True,
        metavar="NAME",
        help=f"Detector and extractor together: auto, {', '.join(BUNDLES)}.",
    ),
    click.option("--detector", metavar="NAME", help=f"Detector alone: {', '.join(DETECTORS)}."),
    click.option("--extractor", metavar="NAME", help=f"Extractor alone: {', '.join(EXTRACTORS)}."),
    click.option("--matcher", metavar="NAME", help=f"Matcher: {', '.join(MATCHERS)}."),
    click.option(
        "--method",
        type=click.Choice(METHODS),
        default="auto",
        show_default=True,
        help="auto: verified, and a second look with learned features where it is not sure; vote: most "
        "matches; verified: geometry, position and probabilities; thorough: the same with a network that "
        "matches photos, in seconds; landmarks: the camera pose from the points of expmap landmarks build.",
    ),
    click.option(
        "--budget",
        type=click.FloatRange(0.0),
        metavar="SECONDS",
        help="With --method auto: time limit of a second look, per photo; 0 for no second look.  "
        f"[default: {_BUDGET.variables[0]}, or {_BUDGET.default}]",
    ),
    _limited(
        "--max-side",
        "extract.max_side_px",
        metavar="PX",
        text="Photos are scaled down until the longer side has this many pixels.",
    ),
    _limited(
        "--keypoints",
        "extract.keypoints",
        metavar="N",
        text="Maximum number of keypoints per photo; the strongest are kept.",
    ),
    _limited(
        "--shortlist",
        "retrieval.shortlist",
        metavar="N",
        text="Number of map photos that are verified for each query.",
    ),
    click.option(
        "--index",
        type=click.Path(file_okay=False, path_type=Path),
        metavar="FOLDER",
        help="Folder for the indexes.  [default: derived/ next to the map]",
    ),
    click.option(
        "--jobs",
        type=click.IntRange(1),
        metavar="N",
        help="Number of processes that build the index.  [default: all cores]",
    ),
]

_ANGLE = click.FloatRange(1.0, 179.0)

_MAP_OPTIONS = [
    click.option(
        "--map-fov",
        type=_ANGLE,
        metavar="DEGREES",
        help="Horizontal field of view of map photos without EXIF focal length.",
    ),
    click.option(
        "--right-within",
        type=click.FloatRange(0.0, min_open=True),
        metavar="PX",
        help="Count answers this near as right.  [default: twice the spacing of the map's photos]",
    ),
    click.option(
        "--map-kind",
        type=click.Choice(MAP_KINDS),
        help="What the positions of the map's photos are: metric: where they were taken; areas: photos of "
        "one position stand for a room, a floor ...; schematic: a plan not to scale.  [default: detected]",
    ),
]


def sequence_options(command: Command) -> Command:
    """Add the options for sequences of photos."""
    for option in reversed(_SEQUENCE_OPTIONS):
        command = option(command)
    return command


def check_sequence(sequence: bool, needing: dict[str, bool]) -> None:
    """Reject given options that need --sequence if it is missing. Raises UsageError."""
    for option, given in needing.items():
        if given and not sequence:
            raise UsageError("can only be used with --sequence", where=option)


_SEQUENCE_OPTIONS = [
    click.option(
        "--sequence", is_flag=True, help="The photos are frames of one sequence: earlier frames count, too."
    ),
    click.option(
        "--speed",
        type=click.FloatRange(0.0, min_open=True),
        metavar="PX",
        help="With --sequence: usual distance from one frame to the next.  [default: that of --right-within]",
    ),
    click.option("--smooth", is_flag=True, help="With --sequence: later frames count, too."),
]


def chosen_settings(cfg: Path, chosen: dict[str, Any]) -> Settings:
    """Load the settings for a map, overridden by the shared options of a command line."""
    settings = settings_in_use(cfg)
    given = {name: chosen[option] for option, name in _EXTRACT.items() if chosen[option] is not None}
    retrieval = settings.retrieval
    if chosen["shortlist"] is not None:
        retrieval = replace(retrieval, shortlist=chosen["shortlist"])
    if chosen["budget"] is not None:
        if not math.isfinite(chosen["budget"]):
            raise UsageError("not a number of seconds", where="--budget", hint="use 0 for no second look")
        retrieval = replace(retrieval, budget_s=chosen["budget"])
    return replace(settings, extract=replace(settings.extract, **given), retrieval=retrieval)


_EXTRACT = {"max_side": "max_side_px", "keypoints": "keypoints"}
"""Options, and the settings of feature extraction that they override."""


def open_options(chosen: dict[str, Any]) -> OpenOptions:
    """Convert the shared options of a command line to `OpenOptions`."""
    return OpenOptions(
        method=chosen["method"],
        features=chosen["features"],
        detector=chosen["detector"],
        extractor=chosen["extractor"],
        matcher=chosen["matcher"],
        index=chosen["index"],
        jobs=chosen["jobs"],
        map_fov_deg=chosen.get("map_fov"),
        right_within_px=chosen.get("right_within"),
        map_kind=chosen.get("map_kind"),
    )
