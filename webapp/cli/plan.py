"""`expmap map plan`: plan where to take the next photos of a map."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from webapp.cli.options import MAP_FILE, area_option
from webapp.core.mapmodel.model import Map
from webapp.core.mapmodel.recognition import Rectangle
from webapp.errors import UsageError
from webapp.files.atomic import write_pieces
from webapp.files.exchange.gpx import format_walk_gpx
from webapp.files.maps.folder import read_map
from webapp.tasks import photo_plan
from webapp.tasks.photo_plan import (
    ENGLISH,
    MOST_SPOTS,
    MapTrials,
    PlanRequest,
    directions_of,
    walk_of,
)

_BY = {
    "evaluation": "by the evaluation of {n} photos",
    "health": "by the survey of {n} photos",
    "none": "by where the photos are; no evaluation of the map is known",
}


@click.command("plan", short_help="Plan where to take the next photos.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.option(
    "--spots", default=12, show_default=True, type=click.IntRange(1, MOST_SPOTS), metavar="N",
    help="How many spots.",
)  # fmt: skip
@area_option(
    "--within", sides="LEFT,TOP,RIGHT,BOTTOM",
    text="An area in pixels of the map's image, where one can walk; default: near the photos.",
)  # fmt: skip
@click.option(
    "--evaluation", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="FILE",
    help="Output of `expmap evaluate --self --json`; default: the last one from the map's Quality page.",
)  # fmt: skip
@click.option(
    "--gpx", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
    help="Write the spots to a GPX file for a phone, as waypoints and a route.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def plan(
    cfg: Path,
    spots: int,
    within: tuple[float, ...] | None,
    evaluation: Path | None,
    gpx: Path | None,
    as_json: bool,
) -> None:
    """Plan the spots and directions in which the next photos of a map help most, as a short walk.

    The probability of recognising each place in each direction is estimated from an evaluation of the map on
    its own photos; without one, from their positions and headings. Spots are near photos, or in the given
    area.
    """
    map_ = read_map(cfg)
    trials = photo_plan.trials_of(map_, cfg) if evaluation is None else _trials(map_, evaluation)
    request = PlanRequest(spots, None if within is None else Rectangle(*within))
    found = photo_plan.plan_json(photo_plan.plan_photos(map_, trials=trials, request=request))
    if gpx is not None:
        walk = walk_of(found)
        write_pieces(gpx, format_walk_gpx(walk, title=f"{map_.title or cfg.resolve().parent.name}: photos"))
    click.echo(json.dumps(found, indent=1) if as_json else "\n".join(_lines(found)))
    click.echo(_summary(cfg, found), err=True)


def _trials(map_: Map, file: Path) -> MapTrials:
    try:
        forms = json.loads(file.read_text(encoding="utf-8"))
        return photo_plan.trials_from_evaluation(map_, forms if isinstance(forms, list) else [forms])
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(
            "this is not an evaluation of a map", where=str(file), hint="run expmap evaluate --self --json"
        ) from error


def _lines(found: dict[str, Any]) -> list[str]:
    return [
        f"{spot['number']:>3}  {_place(spot)}  {directions_of(spot)}; {ENGLISH.reasons[spot['reason']]}"
        for spot in found["spots"]
    ]


def _place(spot: dict[str, Any]) -> str:
    if spot["lat"] is None:
        return f"x {spot['x_px']:.0f}, y {spot['y_px']:.0f}"
    return f"{spot['lat']:.6f}, {spot['lon']:.6f}"


def _summary(cfg: Path, found: dict[str, Any]) -> str:
    way = f"{found['walk_px']:.0f} px" if found["walk_m"] is None else f"{found['walk_m']:.0f} m"
    now, then = found["recognised_share"], found["expected_share"]
    by = _BY[found["trials"]].format(n=found["tried"])
    return f"{cfg}: {len(found['spots'])} spots, {way} on foot; recognised {now:.0%}, then {then:.0%}; {by}"
