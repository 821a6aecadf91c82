"""`expmap connect basemaps`: the image of a map for ATAK, QField, QGIS and web maps."""

from __future__ import annotations

import secrets
import sqlite3
from pathlib import Path

import click
import numpy as np

from webapp.cli.composition import settings_in_use
from webapp.cli.progressbar import terminal_progress
from webapp.connect.basemaps.tiling import Tiling
from webapp.connect.basemaps.writers import Description, write_cog, write_mbtiles, write_pmtiles
from webapp.core.geo.tilegrid import MAX_ZOOM
from webapp.errors import GeoreferenceError, UsageError
from webapp.files.atomic import storage_error
from webapp.files.maps.folder import photo_path, read_map
from webapp.files.satellite.raster import opened_raster
from webapp.tasks.satellite.files import source_of

_WRITERS = {".mbtiles": write_mbtiles, ".pmtiles": write_pmtiles, ".tif": write_cog}


@click.command(short_help="Write the image of a map as MBTiles, PMTiles or GeoTIFF.")
@click.argument("cfg", metavar="MAP.cfg", type=click.Path(path_type=Path))
@click.argument("out", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--zoom", type=click.IntRange(0, MAX_ZOOM), metavar="N",
    help="The most detailed zoom.  [default: the resolution of the image]",
)  # fmt: skip
def basemaps(cfg: Path, out: Path, zoom: int | None) -> None:
    """Write the image of a map as a base map for other programs, which show it without a network.

    FILE ends in .mbtiles (ATAK, QField, Locus), .pmtiles (web maps) or .tif (a cloud-optimised GeoTIFF).
    """
    write = _WRITERS.get(out.suffix.lower())
    if write is None:
        raise UsageError("unknown format", where=out.name, hint=f"use one of {', '.join(_WRITERS)}")
    settings = settings_in_use(cfg)
    found = read_map(cfg)
    if found.georeference is None:
        raise GeoreferenceError(
            "the map has no georeference",
            where=str(cfg),
            hint="set it on the page *Image*, or by control points",
        )
    path = photo_path(cfg, found.satellite.path)
    with opened_raster(path, limits=settings.satellite) as raster:
        tiling = Tiling(np.concatenate([*raster.strips()]), found.georeference, zoom=zoom)
        source = source_of(path.parent, path.name)
        about = Description(
            found.title or cfg.parent.name, attribution=str(source.get("attribution", "")), lossy=raster.lossy
        )
    part = out.with_name(f".{secrets.token_hex(4)}{out.suffix}")
    try:
        with terminal_progress("writing tiles") as progress:
            write(part, tiling, about=about, progress=progress)
        part.replace(out)
    except OSError as error:
        raise storage_error(error, where=str(out)) from error
    except sqlite3.Error as error:
        raise UsageError(f"the file cannot be written: {error}", where=str(out)) from error
    finally:
        part.unlink(missing_ok=True)
    click.echo(f"wrote {out}: zoom {tiling.min_zoom} to {tiling.max_zoom}")
