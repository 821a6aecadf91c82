"""`expmap connect services`: layers of WMS and WMTS for the images of maps, and below them."""

from __future__ import annotations

import io
import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import click
import requests
from PIL import Image

from webapp.cli.library import library_settings
from webapp.connect.services.capabilities import (
    PICTURES,
    MapService,
    OfferedLayer,
    Where,
    capabilities_address,
    parse_capabilities,
    plain,
)
from webapp.core.geo.tilegrid import MAX_ZOOM, TILE_PX, GeoBox, Tile, cut_of
from webapp.errors import GeoreferenceError, InputError, UsageError
from webapp.files.atomic import write_text
from webapp.net.bounded import answering, body, bounded_session
from webapp.net.tiles import TileFetcher, TileService, tile_services
from webapp.progress import Progress
from webapp.settings import TileSettings

_USER_AGENT = "experience-map (capabilities of a map service)"
_MOST_BYTES = 20_000_000
_EUROPE = GeoBox(north=50.01, south=50.0, west=14.0, east=14.01)
_SHORT = {picture.partition("/")[2]: picture for picture in PICTURES}


@dataclass(frozen=True, slots=True)
class _Wish:
    """What the options say of the entry to add."""

    name: str | None
    attribution: str | None
    picture: str | None
    max_zoom: int | None
    public: bool


@click.command(short_help="List the layers of a WMS or WMTS, and offer one for maps.")
@click.argument("address")
@click.option("--layer", metavar="NAME", help="The layer to offer.")
@click.option(
    "--add", metavar="FILE.json", type=click.Path(path_type=Path, dir_okay=False),
    help="Add the layer to this file of tile services.",
)  # fmt: skip
@click.option("--name", metavar="TEXT", help="Its name on the pages.  [default: its title]")
@click.option("--attribution", metavar="TEXT", help="Whom to name with it.  [default: what the service says]")
@click.option(
    "--picture", type=click.Choice([*_SHORT]), help="Format of the tiles.  [default: the first offered]"
)
@click.option(
    "--max-zoom",
    type=click.IntRange(1, MAX_ZOOM),
    metavar="N",
    help="Its largest zoom.",
)
@click.option(
    "--host", "hosts", metavar="HOST", multiple=True, help="A further host that tiles may come from."
)
@click.option("--public", is_flag=True, help="Offer it to visitors of shared maps, too, who see its address.")
def services(
    address: str, layer: str | None, add: Path | None, hosts: tuple[str, ...], **wished: Any
) -> None:
    """List the layers of the WMS or WMTS at ADDRESS; with --layer and --add, offer one on the pages of maps.

    The service is asked for its capabilities, and for one tile of a layer that is added.
    """
    if (layer is None) != (add is None):
        raise UsageError("--layer and --add belong together", hint="give both, or neither to see the layers")
    limits = library_settings(None).tiles
    trusted = frozenset(host.lower() for host in hosts)
    found = _read(address, hosts=trusted, timeout_s=limits.timeout_s)
    if layer is None or add is None:
        for one in found.layers:
            click.echo(_line(one))
        return
    entry = _entry(_chosen(found, layer), found, _Wish(**wished))
    _try_tile(entry, _chosen(found, layer).box, limits)
    _add(entry, add)
    click.echo(f"added {entry['name']} to {add}; a server offers it if EXPMAP_TILE_SERVICES names this file")


def _read(address: str, *, hosts: frozenset[str], timeout_s: float) -> MapService:
    """Ask a service for its capabilities.

    Raises:
        UsageError: It is not a web address.
        InputError: It does not answer, or with something else.
    """
    _check(address)
    asked = capabilities_address(address)
    hint = "check the address in a browser, or try again later"
    try:
        with (
            bounded_session(_USER_AGENT) as session,
            answering(session, asked, most_bytes=_MOST_BYTES, timeout_s=timeout_s) as answer,
        ):
            if answer.is_redirect:
                target = plain(answer.headers["Location"])[:300]
                raise InputError(
                    f"the service redirects to {target}",
                    where=asked,
                    hint="give that address, if you trust it",
                )
            if answer.status_code != requests.codes.ok:
                raise InputError(f"the service answered {answer.status_code}", where=asked, hint=hint)
            data = body(answer, most_bytes=_MOST_BYTES)
    except requests.RequestException as error:
        raise InputError(
            f"the service cannot be reached ({type(error).__name__})", where=asked, hint=hint
        ) from error
    if data is None:
        raise InputError(f"the capabilities have more than {_MOST_BYTES / 1e6:.0f} MB", where=asked)
    found = parse_capabilities(data, Where(asked, hosts))
    if not found.layers:
        raise InputError("the service has no layers", where=asked)
    return found


def _check(address: str) -> None:
    try:
        parts = urlsplit(address)
        is_web = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        is_web = False
    if not is_web or not address.isascii() or set(address) & set("{}\\ ") or "@" in parts.netloc:
        raise UsageError(
            "this is not a web address",
            where=address[:200],
            hint="give https://HOST/PATH, without a password",
        )


def _line(layer: OfferedLayer) -> str:
    about = layer.problem or f"up to zoom {layer.max_zoom}, {', '.join(layer.addresses)}"
    return f"{plain(layer.name)}: {layer.title} ({about})"


def _chosen(found: MapService, name: str) -> OfferedLayer:
    layer = next((one for one in found.layers if one.name == name), None)
    if layer is None:
        hint = f"it has {', '.join(plain(one.name) for one in found.layers[:20])}"
        raise UsageError("the service does not have this layer", where=name[:80], hint=hint)
    if layer.problem is not None:
        raise UsageError(f"the layer cannot be used: {layer.problem}", where=name[:80])
    return layer


def _entry(layer: OfferedLayer, found: MapService, wish: _Wish) -> dict[str, Any]:
    """Make the entry of a layer in a file of tile services."""
    picture = next(iter(layer.addresses)) if wish.picture is None else _SHORT[wish.picture]
    if picture not in layer.addresses:
        offered = ", ".join(one.partition("/")[2] for one in layer.addresses)
        raise UsageError("the layer has no tiles in this format", where="--picture", hint=f"use {offered}")
    return {
        "name": wish.name or layer.title[:120],
        "url": layer.addresses[picture],
        "attribution": wish.attribution or layer.attribution or found.title or layer.title,
        "max_zoom": wish.max_zoom or max(layer.max_zoom, 1),
        "public": wish.public,
    }


def _try_tile(entry: dict[str, Any], box: GeoBox | None, settings: TileSettings) -> None:
    """Fetch a tile in the middle of a layer. Raises InputError."""
    service = TileService(entry["name"], entry["url"], entry["attribution"], entry["max_zoom"])
    zoom, tile = _middle(box or _EUROPE, service.max_zoom)
    with tempfile.TemporaryDirectory() as cache:
        fetcher = TileFetcher(service, cache=Path(cache), settings=settings)
        ((_, data),) = fetcher.fetch([tile], zoom=zoom, progress=Progress())
    try:
        size = None if data is None else Image.open(io.BytesIO(data)).size
    except OSError as error:
        raise InputError("the service sent a damaged tile", where=service.name) from error
    if size not in (None, (TILE_PX, TILE_PX)):
        raise InputError(f"the service sent a tile of {size} pixels, not {TILE_PX}", where=service.name)


def _middle(box: GeoBox, max_zoom: int) -> tuple[int, Tile]:
    """Return a zoom at which an area has a few tiles, and one in its middle."""
    middle = GeoBox(*[(box.north + box.south) / 2] * 2, *[(box.west + box.east) / 2] * 2)
    spot = middle._replace(north=middle.north + 1e-6, east=middle.east + 1e-6)
    try:
        zoom = next((z for z in range(max_zoom) if cut_of(box, z).tile_count > 4), max_zoom)
    except GeoreferenceError:  # it reaches beyond web Mercator
        zoom = min(2, max_zoom)
    return zoom, next(cut_of(spot, zoom).tiles())[0]


def _add(entry: dict[str, Any], path: Path) -> None:
    """Add an entry to a file, or replace that of the same name. Raises UsageError, StorageError."""
    known = []
    if path.exists():
        tile_services(path)  # a file that cannot be used is not changed
        known = json.loads(path.read_text("utf-8"))
    kept = [one for one in known if one["name"] != entry["name"]]
    part = path.with_name(f".{path.name}.part")
    try:
        write_text(part, json.dumps([*kept, entry], indent=2, ensure_ascii=False) + "\n")
        tile_services(part)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
