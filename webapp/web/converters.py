"""Parts of addresses that Flask has no names for."""

from __future__ import annotations

from flask.blueprints import BlueprintSetupState
from werkzeug.routing import BaseConverter


class AnyText(BaseConverter):
    """Any text at the end of an address, with slashes too; of rules with `merge_slashes=False`."""

    regex = ".+"
    part_isolating = False


def set_up(setup: BlueprintSetupState) -> None:
    """Let the addresses of a blueprint use these; for `blueprint.record`, before its first address."""
    setup.app.url_map.converters["text"] = AnyText
