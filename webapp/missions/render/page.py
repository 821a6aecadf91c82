"""A mission as one HTML page that opens without a network: Leaflet, tracks, objects and image are inside."""

from __future__ import annotations

from itertools import islice
from typing import Any

from branca.element import MacroElement
from folium.raster_layers import ImageOverlay

from webapp.core.trajectory.outgoing import MissionOut, ObjectOut, TrackOut, kind_colour
from webapp.errors import UsageError
from webapp.files.exchange.times import utc
from webapp.missions.store import reading
from webapp.missions.store.schema import Mission
from webapp.missions.tasks.icons import icon
from webapp.render.folium_page import data_uri, empty_page, exported_templates
from webapp.render.mercator import MercatorPicture, to_mercator
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.exchange.export_source import Download, Source, of_library, plain_name
from webapp.tasks.maps.thumbnails import encoded, satellite_picture

MAX_OBJECTS = 5000
"""More would make a page that browsers cannot open."""

MAX_POSES = 5000
"""Of each track, evenly spread."""

_IMAGE_SIDE = 4096
_PAD_DEG = 0.0005


class MissionMarks(MacroElement):
    """The tracks and the objects; texts reach the page as data and never as HTML.

    Parameters
    ----------
    tracks : list of dict
        `title`, `colour`, `from`, `to` and `points`: latitude and longitude each.
    objects : list of dict
        `at`, `title`, `facts`, and `kind`, a number of `icons`.
    icons : list of str
        Addresses of pictures.
    """

    def __init__(
        self, tracks: list[dict[str, Any]], *, objects: list[dict[str, Any]], icons: list[str]
    ) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self._name = "MissionMarks"
        self.tracks = tracks
        self.objects = objects
        self.icons = icons
        self._template = exported_templates().get_template("exchange/mission_marks.html")


def run(library: Library, mission_id: int, *, settings: Settings) -> Download:
    """Give a mission as a page, on the image of its map where that has a georeference.

    Parameters
    ----------
    library : Library
    mission_id : int
    settings : Settings

    Returns
    -------
    Download

    Raises
    ------
    NotFound
        There is no such mission.
    UsageError
        It has too many objects for one page.
    """
    mission = reading.read(library.database, mission_id, most=MAX_POSES)
    found = list(islice(mission.objects(), MAX_OBJECTS + 1))
    if len(found) > MAX_OBJECTS:
        raise UsageError(
            f"a page can hold {MAX_OBJECTS} objects, and the mission has more", hint="export KMZ instead"
        )
    text = _page(mission, found, _ground(library, mission_id, settings=settings))
    return Download(
        f"{plain_name(mission.name)}.html",
        "text/html; charset=utf-8",
        iter([text.encode("utf-8", "replace")]),
    )


def _page(mission: MissionOut, found: list[ObjectOut], ground: MercatorPicture | None) -> str:
    page = empty_page("EPSG3857", title=mission.name)
    page.options.update(scale=True)
    if ground is not None:
        box = [[ground.south, ground.west], [ground.north, ground.east]]
        url = data_uri("image/webp", encoded(ground.pixels, ".webp"))
        ImageOverlay(url, box, pixelated=False).add_to(page)
    tracks = [_track(track) for track in mission.tracks]
    kinds = sorted({one.kind for one in found})
    icons = [data_uri("image/png", icon(kind)) for kind in kinds[: reading.MOST_KINDS]]
    objects = [_object(one, kinds.index(one.kind)) for one in found]
    page.add_child(MissionMarks(tracks, objects=objects, icons=icons))
    places = [at for track in tracks for at in track["points"]] + [one["at"] for one in objects]
    if places:
        lats, lons = zip(*places, strict=True)
        page.fit_bounds(
            [[min(lats) - _PAD_DEG, min(lons) - _PAD_DEG], [max(lats) + _PAD_DEG, max(lons) + _PAD_DEG]]
        )
    elif ground is not None:
        page.fit_bounds(box)
    return str(page.get_root().render())


def _ground(library: Library, mission_id: int, *, settings: Settings) -> MercatorPicture | None:
    """Redraw the image of the mission's map as Leaflet lays pictures; None where there is none."""
    with library.database.read() as session:
        map_id = session.get_one(Mission, mission_id).map_id
        record = None if map_id is None else session.get_one(MapRecord, map_id)
        if record is None or record.satellite_path is None or record.georeference is None:
            return None
    source: Source = of_library(library, record.id)
    satellite = source.map.satellite
    picture = satellite_picture(source.cfg, satellite.path, side=_IMAGE_SIDE, settings=settings)
    if picture is None:
        return None
    return to_mercator(picture, source.georeference(), size=(satellite.width, satellite.height))


def _track(track: TrackOut) -> dict[str, Any]:
    points: list[list[float]] = []
    times: list[float] = []
    for part in track.poses():
        points += part.latlon.round(7).tolist()
        times += part.times_s[[0, -1]].tolist()
    first, last = utc([times[0], times[-1]])
    facts = f"{track.distance_m:.0f} m"
    if track.timed:
        facts += f" · {first[:19]}Z – {last[:19]}Z"
    return {
        "title": track.title,
        "facts": facts,
        "colour": track.colour,
        "points": points,
    }


def _object(found: ObjectOut, kind: int) -> dict[str, Any]:
    lat, lon = found.latlon
    facts = [f"{lat:.6f}, {lon:.6f}", utc([found.last_time_s])[0][:19] + "Z"]
    if found.confidence is not None:
        facts.append(f"{found.confidence:.0%}")
    return {
        "at": [lat, lon],
        "title": f"{found.kind} {found.id}",
        "facts": " · ".join(facts),
        "kind": kind,
        "colour": kind_colour(found.kind),
    }
