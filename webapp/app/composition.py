"""What commands get of the whole program; each part is imported when a command asks for it."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, cast

from webapp.cli.composition import Composition

if TYPE_CHECKING:
    from webapp.jobs.kinds import Duties
    from webapp.tasks.operate.parts import LibraryPart


def _duties() -> Duties:
    return cast("Duties", importlib.import_module("webapp.app.jobs").DUTIES)


def _library_parts() -> Sequence[LibraryPart]:
    return cast("Sequence[LibraryPart]", importlib.import_module("webapp.app.library").PARTS)


COMPOSITION = Composition(web_app="webapp.app.web:create_app", duties=_duties, library_parts=_library_parts)
