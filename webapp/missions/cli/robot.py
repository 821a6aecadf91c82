"""`expmap robot`: sends records of a robot, and uploads what is left in its spool."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from webapp.cli.exitcodes import SOME_FAILED
from webapp.cli.progressbar import terminal_progress
from webapp.errors import InputError
from webapp.missions.cli.robot_options import (
    find_target,
    find_token,
    min_move_option,
    mission_options,
    token_option,
)
from webapp.robot.client import RobotClient
from webapp.robot.content import SpoolContent, read_content
from webapp.robot.options import RobotOptions
from webapp.robot.recover import recover as send_all
from webapp.robot.spool import Spool

_SPOOL = click.Path(file_okay=False, path_type=Path)


@click.command()
@click.argument("spool", type=_SPOOL)
@mission_options
@min_move_option
@click.option(
    "--every", type=click.FloatRange(0.1), default=2.0, show_default=True, metavar="S",
    help="Upload every so many seconds.",
)  # fmt: skip
@click.option("--at-end", is_flag=True, help="Upload at the end only, or on the line {type: upload}.")
@click.option(
    "--sync", type=click.FloatRange(0.0), default=0.5, show_default=True, metavar="S",
    help="What a power cut may cost, in seconds; 0: nothing.",
)  # fmt: skip
@click.option(
    "--limit", type=click.FloatRange(1.0), default=1000.0, show_default=True, metavar="MB",
    help="Space for the spool.",
)  # fmt: skip
def send(spool: Path, every: float, at_end: bool, sync: float, limit: float, **chosen: Any) -> int:
    """Send what another program prints: a JSON object a line, as batches have them.

    Reads standard input to its end. Everything is in the folder SPOOL before it is sent, and stays there
    while there is no network. The line {"type": "upload"} uploads at once.
    """
    target = find_target(spool, chosen)
    options = RobotOptions(
        sync_s=sync, every_s=None if at_end else every, limit_mb=limit, min_move=chosen["min_move"]
    )
    with RobotClient(
        target.url, target.token, mission=target.mission, spool=spool, options=options
    ) as client:
        refused = sum(
            not _take(client, line, number=n) for n, line in enumerate(sys.stdin, 1) if line.strip()
        )
        client.close()
        left = client.status()
    if left.waiting or left.photos:
        click.echo(_left(spool, left.waiting, photos=left.photos, problem=left.problem), err=True)
    return SOME_FAILED if refused or left.waiting or left.photos else 0


@click.command()
@click.argument("spool", type=_SPOOL)
@click.option("--url", metavar="URL", help="Of the server, if it has moved.  [default: that of the spool]")
@token_option
@click.option(
    "--patience", type=click.FloatRange(0.0), default=60.0, show_default=True, metavar="S",
    help="Give up when nothing was taken for so many seconds.",
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
    click.echo(f"mission {identity.mission}: everything is at the server")
    return SOME_FAILED if aside else 0


@click.command()
@click.argument("spool", type=_SPOOL)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def status(spool: Path, as_json: bool) -> None:
    """Show what is in the folder SPOOL; the robot may be writing to it."""
    found = read_content(spool)
    click.echo(_as_json(found) if as_json else _as_text(found))


def _take(client: RobotClient, line: str, *, number: int) -> bool:
    """Send a line; print on standard error why it cannot be used."""
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
    return f"{records} records and {photos} photos wait{why}; later: expmap robot recover {spool}"


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
        f"{found.written} records, {found.waiting} of them wait; {found.photos} photos wait",
        f"{found.size / 1e6:.1f} MB",
        *map(_aside, found.aside),
    ]
    return "\n".join(lines)
