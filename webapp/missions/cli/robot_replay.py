"""`expmap robot replay`: sends a recorded mission as if it were happening."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from webapp.cli.exitcodes import SOME_FAILED
from webapp.cli.progressbar import TerminalProgress, terminal_progress
from webapp.core.geo.types import LatLon
from webapp.missions.cli.robot import (
    Target,
    find_target,
    min_move_option,
    mission_options,
    parse_start,
)
from webapp.missions.core.trajectory.robotframe import Start
from webapp.missions.core.trajectory.thinning import parse_min_move
from webapp.missions.tasks import replay_track
from webapp.missions.tasks.replay_track import Replay
from webapp.robot.client import RobotClient
from webapp.robot.options import RobotOptions

_POLL_S = 0.2


@click.command()
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@mission_options
@min_move_option
@click.option(
    "--speed", type=click.FloatRange(0.0, min_open=True), default=1.0, show_default=True, metavar="N",
    help="Speed, as a multiple of the recorded one.",
)  # fmt: skip
@click.option("--topic", "topics", multiple=True, metavar="NAME", help="Only this topic; can be repeated.")
@click.option(
    "--spool", type=click.Path(file_okay=False, path_type=Path), metavar="FOLDER",
    help="Folder of the spool.  [default: NAME.spool]",
)  # fmt: skip
@click.option(
    "--every", type=click.FloatRange(0.05), default=0.5, show_default=True, metavar="S",
    help="Seconds between uploads.",
)  # fmt: skip
def replay(
    bag: Path,
    speed: float,
    topics: tuple[str, ...],
    spool: Path | None,
    every: float,
    **chosen: Any,
) -> int:
    """Send a recorded mission, BAG, to a server as if it were happening.

    BAG is a ROS bag, or any other file with tracks. If the command is killed and started again, it continues
    where it stopped. Prints the address of the mission.
    """
    folder = spool or Path(f"{bag.stem}.spool")
    least, start = parse_min_move(chosen["min_move"]), parse_start(chosen["start"])
    with terminal_progress("read") as progress:
        at = start and Start(LatLon(start["lat"], start["lon"]), start["heading_deg"])
        found = replay_track.replay_track(
            bag, min_move=least, topics=topics, start=at or None, progress=progress
        )
    for left in found.left_out:
        click.echo(f"{left.where}: left out: {left}", err=True)
    target = find_target(folder, chosen)
    about = f"{bag.name}, min-move {least}, topics {', '.join(topics) or 'all'}, start {start}"
    options = RobotOptions(every_s=every, backoff_max_s=10.0)
    with (
        RobotClient(
            target.url, target.token, mission=target.mission, spool=folder, options=options, about=about
        ) as client,
        terminal_progress("replay") as progress,
    ):
        _play(client, found, speed=speed, progress=progress)
        _wait(client, progress)
    _report(found, target)
    return SOME_FAILED if client.status().waiting else 0


def _play(client: RobotClient, found: Replay, *, speed: float, progress: TerminalProgress) -> None:
    """Send the events at their times, without those that an earlier run has written to the spool."""
    done = client.status().written
    progress.size(len(found.events))
    progress.advance(min(done, len(found.events)))
    if done < len(found.events):
        begun, first_s = time.monotonic(), found.events[done].time_s
        for event in found.events[done:]:
            due = begun + (event.time_s - first_s) / speed
            while (left := due - time.monotonic()) > 0:
                time.sleep(min(left, _POLL_S))
                _check(client, progress)
            client.send(event.record)
            progress.advance()
    if done <= len(found.events):
        client.end(left_out=found.rest)


def _wait(client: RobotClient, progress: TerminalProgress) -> None:
    """Wait until everything is uploaded."""
    while not client.upload(wait_s=_POLL_S):
        _check(client, progress)


def _check(client: RobotClient, progress: TerminalProgress) -> None:
    progress.check()
    status = client.status()
    if status.refused is not None:
        raise status.refused


def _report(found: Replay, target: Target) -> None:
    records = len(found.events)
    click.echo(f"{records} records sent, {found.skipped} poses left out", err=True)
    click.echo(f"{target.url.rstrip('/')}/missions/{target.mission}")
