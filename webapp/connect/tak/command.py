"""`expmap connect tak`: a mission in TAK."""

from __future__ import annotations

import socket
import time
import uuid
from pathlib import Path

import click

from webapp.cli.library import existing_library, library_option, library_settings
from webapp.connect.tak.link import TakLink
from webapp.connect.tak.mission import data_package, mission_events
from webapp.files.atomic import write_bytes
from webapp.missions.store import reading

_PEM = click.Path(exists=True, dir_okay=False, path_type=Path)


@click.command(short_help="Send tracks and objects of MISSION to TAK, or write a data package.")
@click.argument("mission", metavar="MISSION", type=int)
@click.argument("target", metavar="TO")
@click.option("--protobuf", is_flag=True, help="Send version 1 of the TAK protocol instead of XML.")
@click.option("--certificate", type=_PEM, metavar="FILE.pem", help="Certificate and key of the client.")
@click.option("--authority", type=_PEM, metavar="FILE.pem", help="Certificate that signed the server's.")
@click.option("--interface", metavar="ADDRESS", help="Address of the interface for multicast.")
@click.option(
    "--keep", type=click.FloatRange(1.0), default=600.0, show_default=True, metavar="SECONDS",
    help="How long TAK shows an item without news.",
)  # fmt: skip
@library_option
def tak(
    mission: int,
    target: str,
    protobuf: bool,
    certificate: Path | None,
    authority: Path | None,
    interface: str | None,
    keep: float,
    library: Path | None,
) -> None:
    """Send the last positions of the tracks of MISSION, and its objects, TO an address or a file.

    TO is tcp://HOST:PORT, tls://HOST:PORT, udp://HOST:PORT, or the name of a data package, FILE.zip.
    """
    settings = library_settings(library)
    with existing_library(settings) as place:
        found = reading.read(place.database, mission, most=2)
        origin = uuid.uuid5(uuid.NAMESPACE_URL, f"//{socket.gethostname()}{settings.library.resolve()}")
        key = f"expmap.{origin}.{mission}"
        events = mission_events(found, key=key, now_s=time.time(), keep_s=keep)
        if target.lower().endswith(".zip") and "://" not in target:
            write_bytes(Path(target), data_package(found.name, events))
            click.echo(f"wrote {target}")
            return
        with TakLink(
            target, protobuf=protobuf, certificate=certificate, authority=authority, interface=interface
        ) as link:
            count = link.send(events)
    click.echo(f"sent {count} items to {target}")
