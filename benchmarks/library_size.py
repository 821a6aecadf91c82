"""Measures the cost of a library with one map: seconds to adopt and to index it, bytes by kind of file.

    python -m benchmarks.library_size FOLDER

FOLDER has a `map.cfg`; it is copied without derived files. With another checkout in PYTHONPATH,
`python benchmarks/library_size.py FOLDER` measures that version. `index_s` is a run of the worker, including
its start.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.tasks.maps.adopt_map import adopt_map


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    source = parser.parse_args().folder.resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "maps"
        shutil.copytree(source, folder / "map", ignore=shutil.ignore_patterns("derived"))
        began = time.perf_counter()
        _adopt(folder)
        adopted = time.perf_counter()
        worker = [sys.executable, "-m", "webapp", "worker", "--once", "--library", str(folder)]
        subprocess.run(worker, check=True, cwd=name)  # not in this folder, as Python would prefer it
        indexed = time.perf_counter()
        if not any((folder / "map" / "derived").rglob("*.features")):
            raise SystemExit("the map was not indexed")
        figures = {
            "adopt_s": round(adopted - began, 2),
            "index_s": round(indexed - adopted, 1),
            "database_kb": round(_bytes(folder / ".library", "library.db*") / 1e3),
            "derived_mb": round(_bytes(folder / "map" / "derived", "*") / 1e6, 2),
            "library_mb": round(_bytes(folder, "*") / 1e6, 2),
        }
    print(json.dumps(figures, indent=2))


def _adopt(folder: Path) -> None:
    library = open_library(folder)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    adopt_map(library, "map", account_id=owner.id)
    library.database.close()


def _bytes(folder: Path, pattern: str) -> int:
    return sum(path.stat().st_size for path in folder.rglob(pattern) if path.is_file())


if __name__ == "__main__":
    main()
