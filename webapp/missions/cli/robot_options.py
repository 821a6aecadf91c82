"""What the commands of `expmap robot` share: where to send, what for, and how."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from webapp.configuration import load_settings
from webapp.errors import UsageError
from webapp.robot.content import has_spool, read_content
from webapp.robot.uplink import NoResponse, Uplink

_URL = "http://127.0.0.1:8000"
_PATIENCE_S = 60.0

Command = Callable[..., Any]


def token_option(command: Command) -> Command:
    """Add the token."""
    return click.option(
        "--token", metavar="TOKEN", help="Of `expmap account token`.  [default: EXPMAP_TOKEN]"
    )(command)


def mission_options(command: Command) -> Command:
    """Add where to send, and to which mission."""
    for option in reversed(_MISSION_OPTIONS):
        command = option(command)
    return token_option(command)


_MISSION_OPTIONS = [
    click.option("--url", metavar="URL", help=f"Of the server.  [default: that of the spool, or {_URL}]"),
    click.option("--mission", type=click.IntRange(1), metavar="N", help="Its number, for a new spool."),
    click.option("--new", metavar="NAME", help="Make a new mission of that name, if the spool is new."),
    click.option("--map", "map_slug", metavar="SLUG", help="Put the new mission on that map."),
    click.option(
        "--start",
        metavar="LAT,LON,HEADING",
        help="Where the robot was at first, in degrees: for poses in its own frame.",
    ),
]

min_move_option = click.option(
    "--min-move",
    default="0.00001deg",
    show_default=True,
    metavar="DISTANCE",
    help="Leave out poses that moved no more: 0.5m, 0.00001deg; 0 keeps all.",
)


@dataclass(frozen=True, slots=True)
class Target:
    """Where a spool is sent."""

    url: str
    token: str
    mission: int


def find_token(given: str | None) -> str:
    """Give the token of the option, or else of the environment.

    Raises
    ------
    UsageError
        There is none.
    """
    token = given or load_settings().token
    if token is None:
        hint = "set EXPMAP_TOKEN; expmap account token --name NAME makes one"
        raise UsageError("there is no token for the server", where="--token", hint=hint)
    return token


def find_target(spool: Path, chosen: dict[str, Any]) -> Target:
    """Find where a spool is sent; for a new one a mission is made where that is asked.

    Parameters
    ----------
    chosen : dict
        The options of `mission_options`.

    Raises
    ------
    UsageError
        Nobody said which mission.
    """
    token, mission, new = find_token(chosen["token"]), chosen["mission"], chosen["new"]
    if has_spool(spool):
        known = read_content(spool).identity
        if new is not None:
            click.echo(f"{spool}: continuing mission {known.mission}", err=True)
        return Target(chosen["url"] or known.url, token, mission or known.mission)
    url = chosen["url"] or _URL
    if (mission is None) == (new is None):
        raise UsageError("a new spool needs a mission", hint="give either --mission N or --new NAME")
    if mission is None:
        wish = {"name": new, "map": chosen["map_slug"], "start": parse_start(chosen["start"])}
        mission = make_mission(url, token, wish={key: value for key, value in wish.items() if value})
    return Target(url, token, mission)


def make_mission(url: str, token: str, *, wish: dict[str, Any]) -> int:
    """Make a mission on the server; return its number.

    Raises
    ------
    ExpMapError
        The server refuses, or does not answer.
    """
    uplink = Uplink(url, token, timeout_s=_PATIENCE_S)
    answer = uplink.post("/missions", wish)
    uplink.close()
    if isinstance(answer, NoResponse) or answer.status != 201:
        raise answer.as_error()
    return int(answer.body["id"])


def parse_start(text: str | None) -> dict[str, float] | None:
    """Read `LAT,LON,HEADING`, degrees each.

    Raises
    ------
    UsageError
    """
    if text is None:
        return None
    hint = "write 50.0755,14.4378,90: degrees north, degrees east, heading clockwise from north"
    try:
        lat, lon, heading = map(float, text.split(","))
    except ValueError as error:
        raise UsageError(f"{text[:60]!r} is not a start", where="--start", hint=hint) from error
    if not (abs(lat) <= 90 and abs(lon) <= 180 and abs(heading) <= 360):
        raise UsageError("the position or heading is out of range", where="--start", hint=hint)
    return {"lat": lat, "lon": lon, "heading_deg": heading}
