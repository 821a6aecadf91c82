"""Generates `api.d.ts`, the types of what the API takes and answers, from its OpenAPI document.

`.venv/bin/python tests/js/make_api_types.py` writes the file; `check.py` fails if it is not up to date. The
scripts of the pages name the types as `Api["PhotoOut"]`.
"""

import json
import subprocess
import tempfile
from pathlib import Path

from webapp.app.web import create_app
from webapp.settings import Settings
from webapp.web.openapi import PATH

PROJECT = Path(__file__).resolve().parents[2]
TYPES = Path(__file__).with_name("api.d.ts")
GENERATOR = PROJECT / ".venv" / "node" / "node_modules" / "openapi-typescript" / "bin" / "cli.js"


def generate() -> str:
    """Return the types of all schemas."""
    with tempfile.TemporaryDirectory() as folder:
        app = create_app(Settings(library=Path(folder) / "library"))
        document = app.test_client().get(PATH).json | {"paths": {}}
        source = Path(folder) / "openapi.json"
        source.write_text(json.dumps(document), "utf-8")
        command = ["node", str(GENERATOR), str(source), "--output", str(source.with_suffix(".d.ts"))]
        subprocess.run(command, check=True, capture_output=True)
        return source.with_suffix(".d.ts").read_text("utf-8")


def problem() -> str:
    """Return why the file is not up to date; empty if it is."""
    if TYPES.is_file() and TYPES.read_text("utf-8") == generate():
        return ""
    return f"{TYPES.relative_to(PROJECT)} is outdated: run `python tests/js/make_api_types.py`"


if __name__ == "__main__":
    TYPES.write_text(generate(), "utf-8")
