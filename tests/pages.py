"""The pages of the program, by what their views state."""

import functools
import tempfile
from pathlib import Path

from webapp.app.web import create_app
from webapp.settings import Settings
from webapp.store.library import open_library
from webapp.web.pages import page_entry


@functools.cache
def _rules():
    with tempfile.TemporaryDirectory() as folder:
        library = open_library(Path(folder))
        app = create_app(Settings(), library=library)
        library.database.close()
    return [one for one in app.url_map.iter_rules() if page_entry(app.view_functions[one.endpoint])]


def addresses(**values):
    """Return the addresses of all pages by endpoint, except those with other variable parts than these."""
    return {
        one.endpoint: one.build({part: values[part] for part in one.arguments})[1]
        for one in _rules()
        if one.arguments <= set(values)
    }
