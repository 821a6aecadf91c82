"""Make the sample: a small map of an invented park, with photos, queries and the truth about them."""

from __future__ import annotations

import json
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from webapp.errors import StorageError, UsageError
from webapp.files.atomic import write_text
from webapp.progress import Progress
from webapp.sample.content import FULL_SIZE, SampleSize, write_sample
from webapp.settings import Settings

RECORD = "sample.json"
"""File by which a folder is known as a sample."""


@dataclass(frozen=True, slots=True)
class Report:
    """What was made.

    Attributes
    ----------
    cfg_path : Path
        The map.
    made : bool
        False when it was there already.
    """

    cfg_path: Path
    made: bool


def make_sample(
    folder: Path | None,
    *,
    settings: Settings,
    progress: Progress,
    seed: int = 7,
    force: bool = False,
    size: SampleSize = FULL_SIZE,
) -> Report:
    """Make the sample, or find that it is there.

    The same seed and size give the same files, byte by byte. The folder appears whole or not at all.

    Parameters
    ----------
    folder : Path or None
        None: `sample` in the library.
    progress : Progress
        One step a picture.
    seed : int
        Of the invented park; 0 or more.
    force : bool
        Make it anew, also over a sample made otherwise.

    Raises
    ------
    UsageError
        The folder holds something else, or a sample from another seed and `force` is not given.
    StorageError
        The disk refused; nothing was changed.
    Cancelled
        Nothing was changed.
    """
    folder = settings.library / "sample" if folder is None else folder
    recipe = {"seed": seed, "photos": size.photos, "queries": size.queries, "width": size.width}
    if _there(folder, recipe, force=force):
        return Report(folder / "map.cfg", made=False)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=".tmp", dir=folder.parent))
        try:
            truth = write_sample(fresh / "new", seed=seed, size=size, progress=progress)
            record = {"note": "an invented park, made by a program", "recipe": recipe, **truth}
            write_text(fresh / "new" / RECORD, json.dumps(record, indent=1) + "\n")
            if folder.exists():
                folder.rename(fresh / "old")
            (fresh / "new").rename(folder)
        finally:
            shutil.rmtree(fresh)
    except OSError as error:
        reason = error.strerror or str(error)
        hint = "choose a folder that you may write to, on a disk with 20 MB free"
        raise StorageError(f"the sample cannot be written: {reason}", where=str(folder), hint=hint) from error
    return Report(folder / "map.cfg", made=True)


def _there(folder: Path, recipe: dict[str, int], *, force: bool) -> bool:
    """Tell whether the folder holds this sample, whole; refuse when it holds what must not be overwritten."""
    if not folder.exists():
        return False
    if not folder.is_dir() or (any(folder.iterdir()) and not (folder / RECORD).is_file()):
        hint = "choose an empty or a new folder"
        raise UsageError("this is not a sample, and is not overwritten", where=str(folder), hint=hint)
    if force or not (folder / RECORD).is_file():
        return False
    try:
        record = json.loads((folder / RECORD).read_text("utf-8"))
        same = record["recipe"] == recipe
        whole = all((folder / name).is_file() for name in record["files"])
    except (ValueError, TypeError, KeyError, OSError) as error:
        raise UsageError(
            f"{RECORD} is damaged", where=str(folder), hint="--force makes the sample anew"
        ) from error
    if not same:
        raise UsageError(
            "another sample is there", where=str(folder), hint="--force replaces it, or choose another folder"
        )
    return whole
