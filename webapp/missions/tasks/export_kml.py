"""A mission as KML, as KMZ with the icons of its objects, and as a link that fetches itself over and over."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from webapp.core.trajectory.outgoing import MissionOut
from webapp.files.exchange.zip_stream import Member, stream_zip
from webapp.missions.files.kml_writer import format_mission_kml, format_network_link
from webapp.missions.tasks.icons import icon
from webapp.tasks.exchange.export_source import Download, plain_name

KML = "application/vnd.google-earth.kml+xml"
KMZ = "application/vnd.google-earth.kmz"

LIVE_POSES = 2000
"""Of each track in what a link fetches: programs draw it anew every few seconds."""

_BYTES_A_POSE = 120
_LARGE_BYTES = 1_500_000_000


def export_mission_kml(mission: MissionOut) -> Download:
    """Give a mission as KML; its objects are coloured pins."""
    return Download(f"{plain_name(mission.name)}.kml", KML, format_mission_kml(mission))


def run_kmz(mission: MissionOut, *, picture: Callable[[str], Path | None] | None = None) -> Download:
    """Give a mission as KMZ: its objects have the icons of their classes, which are inside.

    Parameters
    ----------
    picture : function, optional
        Finds a picture without metadata of a photo, by its SHA-256; None where there is none. Without, no
        photos go along.
    """
    pieces = stream_zip(_members(mission, picture or (lambda _sha: None)))
    return Download(f"{plain_name(mission.name)}.kmz", KMZ, pieces)


def run_link(name: str, *, href: str, refresh_s: float) -> Download:
    """Give a KML that has programs fetch `href` every `refresh_s` seconds.

    Parameters
    ----------
    name : str
        Of the mission.
    href : str
        Absolute address of a KML or KMZ.
    """
    link = format_network_link(name, href=href, refresh_s=refresh_s)
    return Download(f"{plain_name(name)}-live.kml", KML, iter([link]))


def _members(mission: MissionOut, picture: Callable[[str], Path | None]) -> Iterator[Member]:
    """Give pictures and icons, then the KML: it names those that are there."""
    photos: dict[str, str] = {}
    for sha in dict.fromkeys(found.photo for found in mission.objects() if found.photo):
        path = picture(sha)
        if path is not None:
            photos[sha] = f"photos/{sha}{path.suffix}"
            yield Member(photos[sha], path)
    icons = {kind: f"icons/{number}.png" for number, kind in enumerate(mission.kinds)}
    for kind, name in icons.items():
        yield Member(name, icon(kind))
    kml = format_mission_kml(mission, icons=icons, photos=photos)
    bytes_about = _BYTES_A_POSE * sum(track.count for track in mission.tracks)
    yield Member("doc.kml", kml, large=bytes_about > _LARGE_BYTES)
