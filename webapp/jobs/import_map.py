"""The job `import`: an uploaded zip becomes the content of a map that is still empty."""

from __future__ import annotations

from typing import Any

from webapp.errors import NotFound
from webapp.jobs.context import Context
from webapp.tasks.exchange import import_map
from webapp.tasks.exchange.import_map import archive_path

_TOLD = 100
"""At most so many findings are told in the result."""


def run(context: Context) -> dict[str, Any]:
    """Import; the argument `token` names the zip. It is deleted once the map is there."""
    record = context.map()
    archive = archive_path(context.library, context.arguments["token"])
    if not archive.is_file():
        raise NotFound("the uploaded zip is not there any more", hint="upload it again")
    done = import_map.run_into(
        context.library,
        archive,
        map_id=record.id,
        settings=context.settings,
        progress=context.progress,
        writes=context.write,
    )
    archive.unlink(missing_ok=True)
    told = [{"code": f.code, "message": f.message, "fix": f.fix} for f in done.findings]
    return {"findings": told[:_TOLD], "left_out": list(done.left_out[:_TOLD])}
