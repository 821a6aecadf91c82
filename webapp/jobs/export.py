"""The job `export`: a map as a file, kept to be fetched."""

from __future__ import annotations

from typing import Any

from webapp.jobs.context import Context
from webapp.render import export_file


def run(context: Context) -> dict[str, Any]:
    """Make the file; the argument `format` says of which kind."""
    record = context.map()
    download = export_file.run(
        context.library,
        record.id,
        form=context.arguments["format"],
        settings=context.settings,
        progress=context.progress,
    )
    name = export_file.keep(context.library, record.slug, download=download)
    return {"file": name, "media_type": download.media_type, "revision": record.revision}
