"""Exports a mission in any format, including a web page that works without a server."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from webapp.errors import UsageError
from webapp.files.exchange.times import utc
from webapp.missions.core.trajectory.outgoing import ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.symbols import kind_colour
from webapp.missions.render import report_file
from webapp.missions.render.ground import ground_of
from webapp.missions.render.report_file import ExportOptions
from webapp.missions.store import reading
from webapp.missions.tasks import export
from webapp.missions.tasks.export import icon
from webapp.render.folium_page import Feature, add_features, data_uri, empty_page
from webapp.render.mercator import MercatorPicture
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.tasks.exchange.export_source import (
    Download,
    encode_picture,
    plain_name,
)

if TYPE_CHECKING:
    import folium  # loaded by the functions, as in `webapp.render.folium_page`

FORMATS = (*export.FORMATS, "html", *report_file.FORMATS)

MAX_OBJECTS = 5000
"""Maximum number of objects on a page; browsers cannot open larger ones."""

MAX_POSES = 5000
"""Maximum number of poses of each track on a page, evenly spread."""

_USUAL = ExportOptions()
_PAD_DEG = 0.0005
_POPUP = "mission-popup"
_DOT = {"fill": True, "color": "#fff", "weight": 2, "fillOpacity": 1}


def export_mission_file(
    library: Library,
    mission_id: int,
    *,
    form: str,
    settings: Settings,
    options: ExportOptions = _USUAL,
) -> Download:
    """Export a mission; `form` is one of `FORMATS`.

    Raises:
        UsageError: The format or an option is unknown, or the mission is too large for the format.
        NotFound: The mission does not exist.
    """
    if form not in FORMATS:
        raise UsageError(f"unknown export format {form!r}", where="format", hint=f"use {', '.join(FORMATS)}")
    if form == "html":
        return mission_page(library, mission_id, settings=settings)
    if form in report_file.FORMATS:
        return report_file.export_report(library, mission_id, form=form, settings=settings, options=options)
    return export.export_mission(
        library,
        mission_id,
        form=form,
        most=options.most,
        pictures=settings if options.private else None,
        people=options.private,
    )


def mission_page(library: Library, mission_id: int, *, settings: Settings) -> Download:
    """Return a mission as a web page, on the image of its map if that is georeferenced.

    Raises:
        NotFound: The mission does not exist.
        UsageError: The mission has too many objects for one page.
    """
    mission = reading.read(library.database, mission_id, most=MAX_POSES)
    found = list(islice(mission.objects(), MAX_OBJECTS + 1))
    if len(found) > MAX_OBJECTS:
        raise UsageError(
            f"a page can hold {MAX_OBJECTS} objects, and the mission has more", hint="export KMZ instead"
        )
    text = _page(mission, found, ground_of(library, mission_id, settings=settings))
    return Download(
        f"{plain_name(mission.name)}.html",
        "text/html; charset=utf-8",
        iter([text.encode("utf-8", "replace")]),
    )


def _page(mission: MissionExport, found: list[ExportObject], ground: MercatorPicture | None) -> str:
    import folium

    page = empty_page("EPSG3857", title=mission.name)
    folium.Control("Scale", imperial=False).add_to(page)
    if ground is not None:
        box = [[ground.south, ground.west], [ground.north, ground.east]]
        url = data_uri("image/webp", encode_picture(ground.pixels, ".webp"))
        folium.raster_layers.ImageOverlay(url, box, pixelated=False).add_to(page)
    tracks = [_line(track) for track in mission.tracks if not track.look.hidden]
    for line in tracks:
        _add_track(page, line)
    _add_objects(page, found)
    places = [at for line in tracks for at in line.geometry[1]]
    places += [[one.latlon.lon, one.latlon.lat] for one in found]
    if places:
        lons, lats = zip(*places, strict=True)
        page.fit_bounds(
            [[min(lats) - _PAD_DEG, min(lons) - _PAD_DEG], [max(lats) + _PAD_DEG, max(lons) + _PAD_DEG]]
        )
    elif ground is not None:
        page.fit_bounds(box)
    return str(page.get_root().render())


def _add_track(page: folium.Map, line: Feature) -> None:
    """Draw a line with a white border, and a dot at its end."""
    import folium

    points = line.geometry[1]
    border = [(lat, lon) for lon, lat in points]
    weight = line.style["weight"] + 3  # type: ignore[operator]
    white = folium.PolyLine(border, color="#fff", weight=weight, interactive=False)  # type: ignore[no-untyped-call]
    white.add_to(page)
    dot = _DOT | {"fillColor": line.style["color"]}
    end = replace(line, geometry=("Point", points[-1]), style=dot)
    add_features(page, [line], popup=_POPUP, name=line.title)
    add_features(page, [end], popup=_POPUP, name=line.title, marker=folium.CircleMarker(radius=6))


def _add_objects(page: folium.Map, found: list[ExportObject]) -> None:
    """Draw objects as the symbols of their classes, or as dots for classes beyond the maximum number."""
    import folium

    kinds = sorted({one.kind for one in found})[: reading.MOST_KINDS]
    icons = {kind: data_uri("image/png", icon(kind)) for kind in kinds}
    signs, dots = [], []
    for one in found:
        if one.kind in icons:
            signs.append(_object(one, {"iconUrl": icons[one.kind]}))
        else:
            dots.append(_object(one, _DOT | {"fillColor": kind_colour(one.kind)}))
    if signs:
        sign = folium.CustomIcon(
            icons[kinds[0]], icon_size=(32, 32), icon_anchor=(16, 16), popup_anchor=(0, -14)
        )
        add_features(page, signs, marker=folium.Marker(icon=sign), popup=_POPUP, name="Objects")
    add_features(page, dots, marker=folium.CircleMarker(radius=7), popup=_POPUP, name="Objects")


def _line(track: ExportTrack) -> Feature:
    points: list[list[float]] = []
    times: list[float] = []
    for part in track.poses():
        points += part.latlon[:, ::-1].round(7).tolist()
        times += part.times_s[[0, -1]].tolist()
    first, last = utc([times[0], times[-1]])
    facts = f"{track.distance_m:.0f} m"
    if track.timed:
        facts += f" · {first[:19]}Z – {last[:19]}Z"
    if track.remark:
        facts += f" · {track.remark}"
    style = {"color": track.colour, "weight": track.width_px}
    return Feature(("LineString", points), track.title, facts, style)


def _object(found: ExportObject, style: dict[str, object]) -> Feature:
    lat, lon = found.latlon
    facts = [f"{lat:.6f}, {lon:.6f}", utc([found.last_time_s])[0][:19] + "Z"]
    if found.confidence is not None:
        facts.append(f"{found.confidence:.0%}")
    return Feature(("Point", [lon, lat]), f"{found.kind} {found.id}", " · ".join(facts), style)
