"""`expmap connect mavlink`: vehicles with PX4 or ArduPilot as robots of a mission."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import click

from webapp.cli.exitcodes import SOME_FAILED
from webapp.connect.mavlink.links import Link, open_link
from webapp.connect.mavlink.packets import (
    ATTITUDE,
    BATTERY_STATUS,
    GLOBAL_POSITION_INT,
    GPS2_RAW,
    GPS_RAW_INT,
    SYS_STATUS,
    SYSTEM_TIME,
    Packet,
    PacketReader,
    command,
)
from webapp.connect.mavlink.vehicles import Moment, Vehicles
from webapp.errors import InputError, StorageError, UsageError
from webapp.missions.cli.robot import every_option, find_target, min_move_option, target_options
from webapp.robot.client import RobotClient
from webapp.robot.options import RobotOptions

_POLL_S = 0.5
_LONGEST_WAIT_S = 30.0
_ASK_AGAIN_S = 5.0
_SET_MESSAGE_INTERVAL = 511
_MESSAGES = (GLOBAL_POSITION_INT, ATTITUDE, GPS_RAW_INT, GPS2_RAW, SYSTEM_TIME, SYS_STATUS, BATTERY_STATUS)


@click.command(short_help="Send vehicles with PX4 or ArduPilot to a mission, live.")
@click.argument("spool", type=click.Path(file_okay=False, path_type=Path))
@click.argument("source", metavar="FROM")
@target_options
@min_move_option
@every_option
@click.option(
    "--rate", type=click.FloatRange(0.1, 50.0), metavar="HZ",
    help="Ask vehicles for so many positions a second; without it, nothing is sent to them.",
)  # fmt: skip
@click.option(
    "--name", "names", multiple=True, metavar="ID=NAME",
    help="Name of the vehicle with this system id; can be repeated.",
)  # fmt: skip
def mavlink(
    spool: Path, source: str, every: float, rate: float | None, names: tuple[str, ...], **chosen: Any
) -> int:
    """Send the vehicles whose MAVLink comes FROM a source to a mission, until interrupted.

    FROM is udp:0.0.0.0:14550 to listen, tcp:HOST:PORT, or serial:/dev/ttyACM0:57600. Each vehicle is a track
    and a robot. Everything is stored in the folder SPOOL before it is sent, and stays there while there is no
    network.
    """
    vehicles = Vehicles(_names(names), note=lambda text: click.echo(text, err=True))
    link = open_link(source)  # A source that does not work is refused before a mission is made
    with contextlib.ExitStack() as opened:
        opened.enter_context(link)
        target = find_target(spool, chosen)
        options = RobotOptions(every_s=every, min_move=chosen["min_move"])
        client = opened.enter_context(
            RobotClient(
                target.url,
                target.token,
                mission=target.mission,
                spool=spool,
                options=options,
                about="mavlink",
            )
        )
        bridge = _Bridge(client, vehicles, rate_hz=rate)
        with contextlib.suppress(KeyboardInterrupt):
            bridge.run(link, source)
        client.close()
        waiting = client.status().waiting
    where = f"{target.url.rstrip('/')}/missions/{target.mission}"
    click.echo(f"{bridge.written} records of {len(vehicles)} vehicles: {where}")
    for reason, count in bridge.left_out().items():
        click.echo(f"left out: {count} {reason}")
    if waiting:
        click.echo(
            f"{waiting} records are still waiting; to send them: expmap robot recover {spool}", err=True
        )
    return SOME_FAILED if waiting else 0


class _Bridge:
    """Writes what vehicles send to a spool.

    Args:
        rate_hz: Positions to ask for; None: nothing is sent to vehicles.
    """

    def __init__(self, client: RobotClient, vehicles: Vehicles, *, rate_hz: float | None) -> None:
        self._client, self._vehicles, self._rate_hz = client, vehicles, rate_hz
        self._reader = PacketReader()
        self._asked: dict[int, float] = {}
        self._commands = 0
        self._problem = ""
        self.written = 0

    def left_out(self) -> dict[str, int]:
        """Count what was not sent, by reason."""
        found = {
            "packets with a wrong checksum": self._reader.damaged,
            "bytes that belong to no packet": self._reader.garbage,
            **self._vehicles.left_out,
        }
        return {reason: count for reason, count in found.items() if count}

    def run(self, link: Link, source: str) -> NoReturn:
        """Take packets until interrupted, and open the source again whenever it is lost."""
        while True:
            try:
                with link:
                    self._take(link)
            except InputError as error:
                link = _opened_again(source, error)

    def _take(self, link: Link) -> NoReturn:
        while True:
            data = link.read(_POLL_S)
            now = Moment(time.time(), time.monotonic())
            for packet in self._reader.read(data, whole=link.is_whole):
                self._send(self._vehicles.records(packet, now=now))
                self._ask(link, packet, now=now)
            self._send(self._vehicles.reports(now))

    def _send(self, records: Any) -> None:
        for record in records:
            try:
                self._client.send(record)
            except StorageError as error:
                self._vehicles.left_out["records for which there was no room in the spool"] += 1
                if str(error) != self._problem:
                    self._problem = str(error)
                    click.echo(self._problem, err=True)
            except InputError as error:
                self._vehicles.left_out[f"records with an invalid {error.where}"] += 1
            else:
                self.written += 1

    def _ask(self, link: Link, packet: Packet, *, now: Moment) -> None:
        """Ask a vehicle that sends no positions for them."""
        if self._rate_hz is None or not self._vehicles.silent(
            packet, now=now, seconds=1.0 + 2.0 / self._rate_hz
        ):
            return
        if now.monotonic_s - self._asked.get(packet.system, -_ASK_AGAIN_S) < _ASK_AGAIN_S:
            return
        self._asked[packet.system] = now.monotonic_s
        for message in _MESSAGES:
            rate_hz = self._rate_hz if message == GLOBAL_POSITION_INT else min(self._rate_hz, 1.0)
            parameters = (float(message), 1e6 / rate_hz)
            self._commands += 1
            link.write(
                command(packet, number=_SET_MESSAGE_INTERVAL, parameters=parameters, sequence=self._commands)
            )


def _opened_again(source: str, error: InputError) -> Link:
    wait_s = 1.0
    while True:
        click.echo(f"{error}; trying again in {wait_s:g} s", err=True)
        time.sleep(wait_s)
        wait_s = min(2.0 * wait_s, _LONGEST_WAIT_S)
        try:
            link = open_link(source)
        except InputError as again:
            error = again
        else:
            click.echo("connected again", err=True)
            return link


def _names(given: Sequence[str]) -> dict[int, str]:
    """Parse `ID=NAME`. Raises UsageError."""
    found: dict[int, str] = {}
    for text in given:
        number, _, name = text.partition("=")
        if not (number.isdecimal() and 0 < int(number) < 256 and 0 < len(name) <= 200 and name.isprintable()):
            raise UsageError("this is not a name of a vehicle", where=text[:60], hint="write --name 1=Rex")
        if name in found.values():
            raise UsageError("two vehicles have the same name", where=text[:60], hint="give each its own")
        found[int(number)] = name
    return found
