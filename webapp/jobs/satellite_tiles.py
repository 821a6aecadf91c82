"""The job `satellite-tiles`: a map's image from a map tile service."""

from __future__ import annotations

from typing import Any

from webapp.core.geo.tilegrid import Box
from webapp.jobs.context import Context
from webapp.tasks.satellite import tiles
from webapp.tasks.satellite.apply import Choice, set_image
from webapp.tasks.satellite.tiles import TileWish
from webapp.tasks.satellite.unused import taken_back_if_refused


def run(context: Context) -> dict[str, Any]:
    """Fetch the tiles and set the image; tiles that are there already are not fetched again."""
    record = context.map()
    asked = context.arguments
    box = Box(**{name: float(asked[name]) for name in Box._fields})
    fetched = tiles.run(
        context.library,
        record.id,
        wish=TileWish(str(asked["service"]), box, int(asked["zoom"])),
        settings=context.settings,
        progress=context.progress,
    )
    choice = Choice(context.account_id, scale=bool(asked.get("scale")), tray=bool(asked.get("tray")))
    with taken_back_if_refused(context.library, record.id, name=fetched.new.path):
        applied = set_image(context.changing, record.id, new=fetched.new, choice=choice)
    return {
        "width": fetched.new.image.width,
        "height": fetched.new.image.height,
        "metres_per_pixel": fetched.metres_per_pixel,
        "tiles": fetched.tiles,
        "missing": fetched.missing,
        "attribution": fetched.attribution,
        "warnings": list(fetched.warnings),
        "to_tray": applied.to_tray,
        "from_tray": applied.from_tray,
    }
