"""`expmap connect tak`: missions in TAK, and TAK in missions."""

from __future__ import annotations

import contextlib
import hashlib
import json
import socket
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any, TypeVar

import click

from webapp.cli.library import existing_library, library_option, library_settings
from webapp.connect.tak.events import CotEvent
from webapp.connect.tak.feed import TakFeed
from webapp.connect.tak.incoming import Incoming, newest_times
from webapp.connect.tak.link import TakLink
from webapp.connect.tak.mission import data_package, mission_events
from webapp.errors import InputError, RetryLater
from webapp.files.atomic import write_bytes
from webapp.missions.store import reading
from webapp.missions.tasks.store_batch import store_keyed_batch
from webapp.settings import Settings
from webapp.store.library import Library

_PEM = click.Path(exists=True, dir_okay=False, path_type=Path)
_KEEP_KEYS = timedelta(days=2)
_LONGEST_WAIT_S = 30.0


def _link_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of a connection."""
    for option in (
        library_option,
        click.option("--interface", metavar="ADDRESS", help="Address of the interface for multicast."),
        click.option(
            "--authority", type=_PEM, metavar="FILE.pem", help="Certificate that signed the server's."
        ),
        click.option(
            "--certificate", type=_PEM, metavar="FILE.pem", help="Certificate and key of the client."
        ),
    ):
        command = option(command)
    return command


@click.group(short_help="Send a mission to TAK, or receive one from it.")
def tak() -> None:
    """Exchange positions and objects with ATAK, WinTAK, iTAK and TAK servers."""


@tak.command(short_help="Send tracks and objects of MISSION to TAK, or write a data package.")
@click.argument("mission", metavar="MISSION", type=int)
@click.argument("target", metavar="TO")
@click.option("--protobuf", is_flag=True, help="Send version 1 of the TAK protocol instead of XML.")
@click.option(
    "--keep", type=click.FloatRange(1.0), default=600.0, show_default=True, metavar="SECONDS",
    help="How long TAK shows an item without news.",
)  # fmt: skip
@click.option(
    "--follow", type=click.FloatRange(0.2), metavar="SECONDS",
    help="Go on until interrupted, and send what is new so often.",
)  # fmt: skip
@_link_options
def send(
    mission: int,
    target: str,
    protobuf: bool,
    keep: float,
    follow: float | None,
    certificate: Path | None,
    authority: Path | None,
    interface: str | None,
    library: Path | None,
) -> None:
    """Send the last positions of the tracks of MISSION, and its objects, TO an address or a file.

    TO is tcp://HOST:PORT, tls://HOST:PORT, udp://HOST:PORT, or the name of a data package, FILE.zip.
    """
    settings = library_settings(library)
    is_file = target.lower().endswith(".zip") and "://" not in target
    if is_file and follow:
        raise click.UsageError("--follow needs an address, not a file")
    with existing_library(settings) as place:

        def events() -> tuple[str, Iterator[CotEvent]]:
            found = reading.read(place.database, mission, most=2)
            key = _key(settings, mission)
            return found.name, mission_events(found, key=key, now_s=time.time(), keep_s=keep)

        def connect() -> TakLink:
            return TakLink(
                target, protobuf=protobuf, certificate=certificate, authority=authority, interface=interface
            )

        if is_file:
            write_bytes(Path(target), data_package(*events()))
            click.echo(f"wrote {target}")
        elif follow:
            count = _follow(connect, lambda: list(events()[1]), every_s=follow, again_s=keep / 3.0)
            click.echo(f"sent {count} items to {target}")
        else:
            with connect() as link:
                count = link.send(events()[1])
            click.echo(f"sent {count} items to {target}")


@tak.command(short_help="Store positions and markers from TAK in MISSION.")
@click.argument("mission", metavar="MISSION", type=int)
@click.argument("origin", metavar="FROM")
@_link_options
def receive(
    mission: int,
    origin: str,
    certificate: Path | None,
    authority: Path | None,
    interface: str | None,
    library: Path | None,
) -> None:
    """Store what comes FROM an address in MISSION, until interrupted.

    Positions become tracks, markers and emergencies objects. FROM is tcp://HOST:PORT or tls://HOST:PORT of a
    TAK server, or udp://GROUP:PORT of a multicast group.
    """
    settings = library_settings(library)
    with existing_library(settings) as place:
        found = reading.read(place.database, mission, most=2)
        incoming = Incoming(own=_key(settings, mission), newest=newest_times(found))
        stored = 0

        def take(feed: TakFeed) -> None:
            nonlocal stored
            try:
                for events in feed.batches():
                    stored += _store(place, mission, list(incoming.records(events, now_s=time.time())))
            finally:
                incoming.left_out["unreadable"] += feed.unreadable

        def connect() -> TakFeed:
            return TakFeed(origin, certificate=certificate, authority=authority, interface=interface)

        _until_interrupted(connect, take)
    left_out = ", ".join(f"{count} of {type_}" for type_, count in incoming.left_out.most_common(10) if count)
    click.echo(f"stored {stored} records in mission {mission}")
    if left_out:
        click.echo(f"left out: {left_out}")


def _key(settings: Settings, mission: int) -> str:
    """Return what begins the identity of all items of a mission."""
    origin = uuid.uuid5(uuid.NAMESPACE_URL, f"//{socket.gethostname()}{settings.library.resolve()}")
    return f"expmap.{origin}.{mission}."


def _store(place: Library, mission: int, records: list[dict[str, Any]]) -> int:
    if not records:
        return 0
    key = f"tak:{hashlib.sha256(json.dumps(records, sort_keys=True).encode()).hexdigest()}"
    while True:
        try:
            answer = store_keyed_batch(place, mission, records=records, key=key, keep=_KEEP_KEYS)
        except RetryLater as error:
            click.echo(f"{error}; trying again", err=True)
            time.sleep(1.0)
        else:
            return int(answer["stored"])


def _follow(
    connect: Callable[[], TakLink], events: Callable[[], list[CotEvent]], *, every_s: float, again_s: float
) -> int:
    """Send what changed, and everything before it would go stale; return the number of items sent."""
    sent: dict[str, tuple[CotEvent, float]] = {}
    count = 0

    def take(link: TakLink) -> None:
        nonlocal count
        sent.clear()
        while True:
            now = time.monotonic()
            for event in events():
                content = _content(event)
                known, at = sent.get(event.uid, (None, 0.0))
                if content != known or now - at >= again_s:
                    count += link.send([event])
                    sent[event.uid] = content, now
            time.sleep(every_s)

    _until_interrupted(connect, take)
    return count


def _content(event: CotEvent) -> CotEvent:
    """Return an event without the times that differ at each poll: tracks without times begin now."""
    start_s = 0.0 if event.start_s == event.time_s else event.start_s
    return replace(event, time_s=0.0, start_s=start_s, stale_s=0.0)


_Connection = TypeVar("_Connection", TakLink, TakFeed)


def _until_interrupted(connect: Callable[[], _Connection], take: Callable[[_Connection], None]) -> None:
    """Use a connection until Ctrl-C, and connect again whenever it is lost; the first must succeed."""
    wait_s = 0.0
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            try:
                with connect() as connection:
                    if wait_s:
                        click.echo("connected again", err=True)
                    wait_s = 1.0
                    take(connection)
            except InputError as error:
                if not wait_s:
                    raise
                click.echo(f"{error}; trying again in {wait_s:g} s", err=True)
                time.sleep(wait_s)
                wait_s = min(2.0 * wait_s, _LONGEST_WAIT_S)
