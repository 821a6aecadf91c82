"""A mission as KML, as KMZ with the icons of its objects, and as a link that fetches itself over and over."""

from __future__ import annotations

from collections.abc import Iterator

from webapp.core.trajectory.outgoing import MissionOut
from webapp.files.missionkml import format_mission_kml, format_network_link
from webapp.files.zipstream import Member, stream_zip
from webapp.tasks.export_source import Download, plain_name
from webapp.tasks.mission_icons import icon

KML = "application/vnd.google-earth.kml+xml"
KMZ = "application/vnd.google-earth.kmz"

LIVE_POSES = 2000
"""Of each track in what a link fetches: programs draw it anew every few seconds."""

_BYTES_A_POSE = 120
_LARGE_BYTES = 1_500_000_000


def run(mission: MissionOut) -> Download:
    """Give a mission as KML; its objects are coloured pins."""
    return Download(f"{plain_name(mission.name)}.kml", KML, format_mission_kml(mission))


def run_kmz(mission: MissionOut) -> Download:
    """Give a mission as KMZ: its objects have the icons of their classes, which are inside."""
    return Download(f"{plain_name(mission.name)}.kmz", KMZ, stream_zip(_members(mission)))


def run_link(name: str, *, href: str, refresh_s: float) -> Download:
    """Give a KML that has programs fetch `href` every `refresh_s` seconds.

    Parameters
    ----------
    name : str
        Of the mission.
    href : str
        Absolute address of a KML or KMZ.
    refresh_s : float
    """
    link = format_network_link(name, href=href, refresh_s=refresh_s)
    return Download(f"{plain_name(name)}-live.kml", KML, iter([link]))


def _members(mission: MissionOut) -> Iterator[Member]:
    icons = {kind: f"icons/{number}.png" for number, kind in enumerate(mission.kinds)}
    bytes_about = _BYTES_A_POSE * sum(track.count for track in mission.tracks)
    yield Member("doc.kml", format_mission_kml(mission, icons=icons), large=bytes_about > _LARGE_BYTES)
    for kind, path in icons.items():
        yield Member(path, icon(kind))
