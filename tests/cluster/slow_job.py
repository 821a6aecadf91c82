"""Jobs with parts computed by Dask: one with slow parts, and one that counts its threads."""

import time
from pathlib import Path

from webapp.tasks.computing.in_order import ExecutionTarget, in_order

PARTS, SECONDS = 200, 0.5


def part(folder: Path, number: int) -> int:
    """Leave a file behind when it begins."""
    (folder / f"part-{number}").touch()
    time.sleep(SECONDS)
    return number


def native_threads(_: object, seconds: float) -> int:
    """Count the threads that Faiss may use for this part."""
    import faiss

    time.sleep(seconds)
    return int(faiss.omp_get_max_threads())


def compute(context):
    """Do all parts."""
    context.progress.size(PARTS)
    folder = context.library.inner
    at = ExecutionTarget(context.settings, folder)
    for _ in in_order(part, range(PARTS), shared=folder, at=at, progress=context.progress):
        context.progress.advance()
