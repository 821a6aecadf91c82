"""Runs pycolmap's mappers in a separate process: they cannot be stopped otherwise, and need much memory."""

from __future__ import annotations

import multiprocessing
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from webapp.errors import ProcessLost
from webapp.files.landmarks.adjust import AdjustJob, adjust
from webapp.files.landmarks.colmap import Model, StoredSubmodels, as_model, pycolmap
from webapp.logs import Carried, carried
from webapp.progress import Progress
from webapp.tasks.computing.local import start_worker

MATCHES_FILE = "matches.db"
ADJUSTED = "adjusted"
"""Folder of the model joined by known positions, in a subfolder named by the hash of these."""

Job = TypeVar("Job")
Found = TypeVar("Found")

_LOOK_EVERY_S = 0.5
_SEED = 1
_OUT = {False: "models", True: "models-incremental"}


@dataclass(frozen=True, slots=True)
class MappingJob:
    database: Path
    # Has a subfolder per mapper for its models, in COLMAP's format; earlier models there are deleted.
    folder: Path
    contents: tuple[str, ...]  # Content hashes of the photos that take part
    is_incremental: bool = False  # Whether to run incremental structure from motion, else global

    @property
    def out(self) -> Path:
        """Folder of this mapper's models."""
        return self.folder / _OUT[self.is_incremental]


def run_mapper(job: MappingJob, *, progress: Progress) -> list[Model]:
    """Reconstruct models from photos.

    Raises:
        ProcessLost: The process was killed.
    """
    return _run_apart(map_photos, job, progress=progress)


def run_adjustment(job: AdjustJob, *, progress: Progress) -> Model | None:
    """Join submodels by known positions; see `files.landmarks.adjust`. Raises ProcessLost, Cancelled."""
    return _run_apart(adjust, job, progress=progress)


def _run_apart(run: Callable[[Job], Found], job: Job, *, progress: Progress) -> Found:
    # Spawn, not fork: OpenCV and Faiss have threads, which do not survive a fork.
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_run, args=(run, job, sender), kwargs={"log": carried()}, daemon=True)
    process.start()
    sender.close()
    try:
        while not receiver.poll(_LOOK_EVERY_S):
            progress.check()
        found: Found = receiver.recv()
        return found
    except EOFError as error:
        raise ProcessLost(
            "the process that reconstructs was killed",
            hint="too little memory? In a script, call it below if __name__ == '__main__':",
        ) from error
    finally:
        process.kill()
        process.join()
        receiver.close()


def model_folders(folder: Path) -> list[Path]:
    return [path.parent for name in _OUT.values() for path in sorted((folder / name).glob("*/images.bin"))]


def adjusted_folders(folder: Path, submodels: StoredSubmodels) -> list[Path]:
    """Return a list of the folder of the joined model; empty if the submodels were not joined."""
    joined = folder / ADJUSTED / submodels.adjusted
    return [joined] if submodels.adjusted and not submodels.problem else []


def _run(run: Callable[[Job], Found], job: Job, sender: Connection, *, log: Carried) -> None:
    start_worker(log)
    sender.send(run(job))
    sender.close()


def map_photos(job: MappingJob) -> list[Model]:
    """Reconstruct models from photos, in this process."""
    colmap = pycolmap()
    for name in [_OUT[True]] if job.is_incremental else _OUT.values():
        shutil.rmtree(job.folder / name, ignore_errors=True)
    job.out.mkdir(parents=True)
    run = _incremental if job.is_incremental else _global
    return [as_model(model) for model in run(colmap, job).values()]


def _global(colmap: Any, job: MappingJob) -> dict[int, Any]:
    options = colmap.GlobalPipelineOptions()
    options.image_names = list(job.contents)
    options.random_seed = _SEED
    models: dict[int, Any] = colmap.global_mapping(job.database, job.out, job.out, options)
    return models


def _incremental(colmap: Any, job: MappingJob) -> dict[int, Any]:
    options = colmap.IncrementalPipelineOptions()
    options.image_names = list(job.contents)
    options.random_seed = _SEED
    options.min_model_size = 3
    options.extract_colors = False
    # Photos of a walk often look ahead, so that the views of two of them differ little.
    options.mapper.init_max_forward_motion = 1.0
    options.mapper.init_min_tri_angle = 4.0
    options.mapper.init_min_num_inliers = 50
    models: dict[int, Any] = colmap.incremental_mapping(job.database, job.out, job.out, options)
    return models
