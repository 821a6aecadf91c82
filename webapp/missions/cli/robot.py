"""`expmap robot`: sends records of a robot, and uploads the rest of its spool."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from webapp.cli.exitcodes import SOME_FAILED
from webapp.cli.progressbar import terminal_progress
from webapp.configuration import load_settings
from webapp.errors import InputError, UsageError
from webapp.robot.client import RobotClient
from webapp.robot.content import SpoolContent, has_spool, read_content
from webapp.robot.options import RobotOptions
from webapp.robot.spool import Spool
from webapp.robot.uplink import NoResponse, Uplink
from webapp.robot.uploader import recover as send_all

_URL = "http://127.0.0.1:8000"
_PATIENCE_S = 60.0

Command = Callable[..., Any]

_TARGET_OPTIONS = [
    click.option(
        "--url", metavar="URL", help=f"Address of the server.  [default: that of the spool, or {_URL}]"
    ),
    click.option(
        "--mission", type=click.IntRange(1), metavar="N", help="Number of the mission, for a new spool."
    ),
    click.option("--new", metavar="NAME", help="Make a new mission of that name, if the spool is new."),
    click.option("--map", "map_slug", metavar="SLUG", help="Put the new mission on that map."),
]
_start_option = click.option(
    "--start",
    metavar="LAT,LON,HEADING",
    help="Where the robot started, and its heading in degrees clockwise from north.",
)
every_option = click.option(
    "--every", type=click.FloatRange(0.1), default=2.0, show_default=True, metavar="S",
    help="Seconds between uploads.",
)  # fmt: skip
min_move_option = click.option(
    "--min-move",
    default="0.00001deg",
    show_default=True,
    metavar="DISTANCE",
    help="Leave out poses that moved no farther: 0.5m, 0.00001deg; 0 keeps all.",
)
_SPOOL = click.Path(file_okay=False, path_type=Path)


def token_option(command: Command) -> Command:
    """Add the option for the API token."""
    return click.option(
        "--token", metavar="TOKEN", help="Token from `expmap account token`.  [default: EXPMAP_TOKEN]"
    )(command)


def target_options(command: Command) -> Command:
    """Add the options for the server and the mission."""
    for option in reversed(_TARGET_OPTIONS):
        command = option(command)
    return token_option(command)


def mission_options(command: Command) -> Command:
    """Add the options for the server, the mission and its start."""
    return target_options(_start_option(command))


@dataclass(frozen=True, slots=True)
class Target:
    """Server and mission to which a spool is sent."""

    url: str
    token: str
    mission: int


def find_token(given: str | None) -> str:
    """Return the token of the option, or else of the environment.

    Raises:
        UsageError: Neither has one.
    """
    token = given or load_settings().token
    if token is None:
        hint = "set EXPMAP_TOKEN; expmap account token --name NAME makes one"
        raise UsageError("there is no token for the server", where="--token", hint=hint)
    return token


def find_target(spool: Path, chosen: dict[str, Any]) -> Target:
    """Find the target of a spool; for a new spool, create the mission if requested.

    Args:
        chosen: The options of `mission_options` or `target_options`.

    Raises:
        UsageError: The spool is new, and not exactly one of `--mission` and `--new` is given.
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
        fields = {"name": new, "map": chosen["map_slug"], "start": parse_start(chosen.get("start"))}
        mission = make_mission(url, token, fields={key: value for key, value in fields.items() if value})
    return Target(url, token, mission)


def make_mission(url: str, token: str, *, fields: dict[str, Any]) -> int:
    """Create a mission on the server; return its number.

    Raises:
        ExpMapError: The server refuses, or does not respond.
    """
    uplink = Uplink(url, token, timeout_s=_PATIENCE_S)
    answer = uplink.post("/missions", fields)
    uplink.close()
    if isinstance(answer, NoResponse) or answer.status != 201:
        raise answer.as_error()
    return int(answer.body["id"])


def parse_start(text: str | None) -> dict[str, float] | None:
    """Parse `LAT,LON,HEADING`, all in degrees. Raises UsageError."""
    if text is None:
        return None
    hint = "write 50.0755,14.4378,90: degrees north, degrees east, heading clockwise from north"
    try:
        lat, lon, heading = map(float, text.split(","))
    except ValueError as error:
        raise UsageError(
            f"{text[:60]!r} is not a start position and heading", where="--start", hint=hint
        ) from error
    if not (abs(lat) <= 90 and abs(lon) <= 180 and abs(heading) <= 360):
        raise UsageError("the position or heading is out of range", where="--start", hint=hint)
    return {"lat": lat, "lon": lon, "heading_deg": heading}


@click.command()
@click.argument("spool", type=_SPOOL)
@mission_options
@min_move_option
@every_option
@click.option("--at-end", is_flag=True, help="Upload at the end only, or on the line {type: upload}.")
@click.option(
    "--sync", type=click.FloatRange(0.0), default=0.5, show_default=True, metavar="S",
    help="How many seconds of data a power cut may lose; 0: none.",
)  # fmt: skip
@click.option(
    "--limit", type=click.FloatRange(1.0), default=1000.0, show_default=True, metavar="MB",
    help="Maximum size of the spool.",
)  # fmt: skip
def send(spool: Path, every: float, at_end: bool, sync: float, limit: float, **chosen: Any) -> int:
    """Send records that another program prints: one JSON object per line, as in batches.

    Reads standard input to its end. Everything is stored in the folder SPOOL before it is sent, and stays
    there while there is no network. The line {"type": "upload"} uploads at once.
    """
    target = find_target(spool, chosen)
    options = RobotOptions(
        sync_s=sync, every_s=None if at_end else every, limit_mb=limit, min_move=chosen["min_move"]
    )
    with RobotClient(
        target.url, target.token, mission=target.mission, spool=spool, options=options
    ) as client:
        taken = [_take(client, line, number=n) for n, line in enumerate(sys.stdin, 1) if line.strip()]
        client.close()
        left = client.status()
    refused = taken.count(False)
    if left.waiting or left.photos:
        click.echo(_left(spool, left.waiting, photos=left.photos, problem=left.problem), err=True)
    else:
        where = f"{target.url}/missions/{target.mission}"
        click.echo(f"{len(taken) - refused} lines sent, {refused} refused: {where}", err=True)
    return SOME_FAILED if refused or left.waiting or left.photos else 0


@click.command()
@click.argument("spool", type=_SPOOL)
@click.option(
    "--url", metavar="URL", help="Address of the server, if it has moved.  [default: that of the spool]"
)
@token_option
@click.option(
    "--patience", type=click.FloatRange(0.0), default=60.0, show_default=True, metavar="S",
    help="Give up when the server has accepted nothing for this many seconds.",
)  # fmt: skip
def recover(spool: Path, url: str | None, token: str | None, patience: float) -> int:
    """Upload what a robot has left in the folder SPOOL."""
    known, secret = read_content(spool), find_token(token)
    identity = known.identity
    opened = Spool(spool, identity=replace(identity, url=url or identity.url))
    try:
        begun, before = opened.waiting + opened.photos.count, len(known.aside)
        with terminal_progress("upload") as progress:
            progress.size(begun)
            shown = begun

            def on_progress(left: int) -> None:
                nonlocal shown
                progress.advance(shown - left)
                shown = left
                progress.check()

            send_all(opened, secret, options=RobotOptions(), patience_s=patience, on_progress=on_progress)
    finally:
        opened.close()
    aside = read_content(spool).aside[before:]
    for entry in aside:
        click.echo(_aside(entry), err=True)
    click.echo(f"mission {identity.mission}: everything has been uploaded")
    return SOME_FAILED if aside else 0


@click.command()
@click.argument("spool", type=_SPOOL)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def status(spool: Path, as_json: bool) -> None:
    """Show what is in the folder SPOOL, even while the robot is writing to it."""
    found = read_content(spool)
    click.echo(_as_json(found) if as_json else _as_text(found))


def _take(client: RobotClient, line: str, *, number: int) -> bool:
    """Send the record of a line; return False and report it on standard error if it is invalid."""
    try:
        record = json.loads(line)
        if not isinstance(record, dict):
            raise InputError(
                "this is not a JSON object", hint='write {"type": "pose", "lat": 50.0755, "lon": 14.4378}'
            )
        if record == {"type": "upload"}:
            client.upload()
        else:
            client.send(record)
    except InputError as error:
        click.echo(f"line {number}: {error}", err=True)
        return False
    except ValueError as error:
        click.echo(f"line {number}: this is not JSON: {error}", err=True)
        return False
    return True


def _left(spool: Path, records: int, *, photos: int, problem: str) -> str:
    why = f" ({problem})" if problem else ""
    left = f"{records} records and {photos} photos are still waiting{why}"
    return f"{left}; to send them later: expmap robot recover {spool}"


def _aside(entry: dict[str, Any]) -> str:
    if entry["count"] == 0:
        about = entry.get("photo", "end of the records")
    elif entry["count"] == 1:
        about = f"record {entry['first']}"
    else:
        about = f"records {entry['first']} to {entry['first'] + entry['count'] - 1}"
    return f"{about}: {entry['reason']}"


def _as_json(found: SpoolContent) -> str:
    return json.dumps(
        {
            "spool": found.identity.id,
            "mission": found.identity.mission,
            "url": found.identity.url,
            "about": found.identity.about,
            "written": found.written,
            "acknowledged": found.written - found.waiting,
            "waiting": found.waiting,
            "photos_waiting": found.photos,
            "bytes": found.size,
            "aside": found.aside,
        },
        indent=2,
        ensure_ascii=False,
    )


def _as_text(found: SpoolContent) -> str:
    lines = [
        f"mission {found.identity.mission} at {found.identity.url}",
        f"{found.written} records, {found.waiting} of them waiting; {found.photos} photos waiting",
        f"{found.size / 1e6:.1f} MB",
        *map(_aside, found.aside),
    ]
    return "\n".join(lines)
