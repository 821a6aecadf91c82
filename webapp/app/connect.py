"""`expmap connect`: the commands of the connections that are installed."""

from __future__ import annotations

from webapp.app.main import LazyCommand, LazyGroup
from webapp.connect import connections

connect_group = LazyGroup(
    name="connect",
    help="Connect with other programs.",
    commands={name: LazyCommand(found.command, found.summary) for name, found in connections().items()},
)
