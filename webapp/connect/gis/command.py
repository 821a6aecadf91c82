"""`expmap connect gis`: maps and missions for QGIS, QField, ArcGIS and other programs."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.library import existing_library, library_option, library_settings
from webapp.cli.progressbar import terminal_progress
from webapp.connect.gis.geopackage import new_package
from webapp.connect.gis.layers import add_map, add_mission
from webapp.connect.gis.project import write_project
from webapp.connect.gis.project_image import images_of
from webapp.missions.store import reading
from webapp.tasks.exchange.export_source import of_folder, thumbnail

_ATTACHED_SIDE = 1600
_OUT = click.argument("out", metavar="FILE.gpkg", type=click.Path(path_type=Path, dir_okay=False))

_PROJECT = click.argument("out", metavar="FILE.qgz", type=click.Path(path_type=Path, dir_okay=False))
_POINTS = click.option(
    "--points", type=click.IntRange(2), metavar="N", help="At most N poses of each track, evenly spread."
)


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


@gis.command(short_help="Write a map as a project of QGIS.")
@click.argument("cfg", metavar="MAP.cfg", type=click.Path(path_type=Path))
@_PROJECT
def project(cfg: Path, out: Path) -> None:
    """Write a map, which has a georeference, as a project of QGIS: its images, photos, notes and floors."""
    settings, source = settings_in_use(cfg), of_folder(cfg)
    if source.map.title:
        source = of_folder(cfg, title=source.map.title)
    with terminal_progress("photos") as progress, TemporaryDirectory() as folder:
        package = Path(folder) / "layers.gpkg"
        with new_package(package) as layers:
            count = add_map(layers, source, folder=out.parent, picture=lambda _photo: None, progress=progress)
        images = images_of(source, Path(folder), settings=settings)
        write_project(out, package, images=images, title=source.title)
    click.echo(f"wrote {out}: {count} photos, {len(images)} images")


@gis.command("project-mission", short_help="Write MISSION as a project of QGIS.")
@click.argument("mission", metavar="MISSION", type=int)
@_PROJECT
@_POINTS
@library_option
def project_mission(mission: int, out: Path, points: int | None, library: Path | None) -> None:
    """Write the tracks, objects and areas of MISSION, given by its number, as a project of QGIS."""
    settings = library_settings(library)
    with existing_library(settings) as place, TemporaryDirectory() as folder:
        found = reading.read(place.database, mission, most=points)
        package = Path(folder) / "layers.gpkg"
        with terminal_progress("tracks") as progress, new_package(package) as layers:
            tracks, poses, objects = add_mission(layers, found, progress=progress)
        write_project(out, package, images=[], title=found.name)
    click.echo(f"wrote {out}: {tracks} tracks, {poses} poses, {objects} objects")


@gis.command("export-mission", short_help="Write the tracks and objects of MISSION as a GeoPackage.")
@click.argument("mission", metavar="MISSION", type=int)
@_OUT
@_POINTS
@library_option
def export_mission(mission: int, out: Path, points: int | None, library: Path | None) -> None:
    """Write the tracks and objects of MISSION, given by its number, as layers of a GeoPackage."""
    settings = library_settings(library)
    with existing_library(settings) as place:
        found = reading.read(place.database, mission, most=points)
        with terminal_progress("tracks") as progress, new_package(out) as package:
            tracks, poses, objects = add_mission(package, found, progress=progress)
    click.echo(f"wrote {out}: {tracks} tracks, {poses} poses, {objects} objects")
