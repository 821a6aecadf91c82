"""`expmap connect gis`: maps and missions for QGIS, QField, ArcGIS and other programs."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.library import existing_library, library_option, library_settings
from webapp.cli.progressbar import terminal_progress
from webapp.connect.gis.geopackage import new_package
from webapp.connect.gis.layers import add_map, add_mission
from webapp.missions.store import reading
from webapp.tasks.exchange.export_source import of_folder, thumbnail

_ATTACHED_SIDE = 1600
_OUT = click.argument("out", metavar="FILE.gpkg", type=click.Path(path_type=Path, dir_okay=False))


@click.group(short_help="Write a map or a mission as a GeoPackage for QGIS and QField.")
def gis() -> None:
    """Give maps and missions to programs for geographic data, such as QGIS, QField and ArcGIS."""


@gis.command(short_help="Write the photos, notes and floors of a map as a GeoPackage.")
@click.argument("cfg", metavar="MAP.cfg", type=click.Path(path_type=Path))
@_OUT
@click.option("--attach", is_flag=True, help="Store pictures of the photos in the file, without EXIF.")
def export(cfg: Path, out: Path, attach: bool) -> None:
    """Write the photos, notes and floors of a map, which has a georeference, as layers of a GeoPackage."""
    settings = settings_in_use(cfg)
    source = of_folder(cfg)
    if source.map.title:
        source = of_folder(cfg, title=source.map.title)
    make = partial(thumbnail, source, side=_ATTACHED_SIDE, limits=settings.photo)
    with terminal_progress("photos") as progress, new_package(out) as package:
        count = add_map(
            package,
            source,
            folder=out.parent,
            picture=make if attach else lambda _photo: None,
            progress=progress,
        )
    click.echo(f"wrote {out}: {count} photos")


@gis.command("export-mission", short_help="Write the tracks and objects of MISSION as a GeoPackage.")
@click.argument("mission", metavar="MISSION", type=int)
@_OUT
@click.option(
    "--points", type=click.IntRange(2), metavar="N", help="At most N poses of each track, evenly spread."
)
@library_option
def export_mission(mission: int, out: Path, points: int | None, library: Path | None) -> None:
    """Write the tracks and objects of MISSION, given by its number, as layers of a GeoPackage."""
    settings = library_settings(library)
    with existing_library(settings) as place:
        found = reading.read(place.database, mission, most=points)
        with terminal_progress("tracks") as progress, new_package(out) as package:
            tracks, poses, objects = add_mission(package, found, progress=progress)
    click.echo(f"wrote {out}: {tracks} tracks, {poses} poses, {objects} objects")
