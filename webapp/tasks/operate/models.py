"""Lists the weights of networks, fetches, accepts and tries them, and queues second indexes."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, cast

import cv2
import numpy as np
from numpy.typing import NDArray
from sqlalchemy import select

from webapp.core.features.entry import ModelFile
from webapp.core.features.extract import extract
from webapp.core.features.lightglue import PairMatcher
from webapp.core.features.table import EXTRACTORS, PAIR_MATCHERS, choose
from webapp.core.features.types import Features
from webapp.errors import InputError, MissingPart, NotFound, StorageError, UsageError
from webapp.files import atomic
from webapp.files.localize.models import (
    MODELS,
    NETWORKS,
    checked_weights,
    find_weights,
    global_descriptor,
    global_model_problem,
    install_hint,
    installed,
    matches_hash,
    models_folder,
    network,
    open_model,
    read_model,
)
from webapp.net.bounded import download
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord

Models = Mapping[str, tuple[ModelFile, ...]]

SECOND_LOOK = ("xfeat", PAIR_MATCHERS["xfeat"])
"""The models of the second look of method `auto`: its features, and the network that matches them."""

PURPOSES: dict[str, str] = dict.fromkeys(MODELS, "Features to choose yourself.") | {
    "xfeat": "The second look of method auto, which finds hard photos, such as those by night.",
    "lighterglue": "Matches the second look's photos: more hard photos are found, and more surely.",
    "faces": "Finds faces to blur.",
    "plates": "Finds number plates to blur.",
    "aliked-lightglue": "Matches photos by the features aliked, in method thorough.",
    "global": "Compares photos as a whole, which helps to find them on large maps.",
}
"""What each model is for."""

_BY_NIGHT = {(): 25, ("xfeat",): 67, SECOND_LOOK: 77}
"""Percentage of 150 photos by night that are localized correctly on a map by day with these models."""


@dataclass(frozen=True, slots=True)
class ModelState:
    """A file with weights, and whether it is installed."""

    model: str  # Name of features, or of a network that matches them
    file: ModelFile
    # "here", "missing", "damaged" or "unusable". Files supplied by the user are never "damaged", as they have
    # no known hash; that of a global descriptor is loaded as a test.
    state: str
    problem: str = ""  # Why it is unusable


def states(settings: Settings, *, models: Models = MODELS) -> list[ModelState]:
    """Check which weights are installed, by their hashes, and whether a global descriptor can be used."""
    folder = models_folder(settings.models)
    found = [ModelState(name, f, _state(folder / f.name, f)) for name, files in models.items() for f in files]
    problem = global_model_problem(settings.models)
    return [
        replace(s, state="unusable", problem=problem) if problem and s.model == "global" else s for s in found
    ]


def missing(names: Collection[str], *, settings: Settings, models: Models = MODELS) -> list[str]:
    """List the models with published files that are not installed.

    Args:
        names: Models; if empty, all with published files.

    Raises:
        UsageError: A name is unknown, or the model has no published file.
    """
    unknown = next((name for name in names if name not in models), None)
    if unknown is not None:
        raise UsageError(f"unknown model {unknown!r}", where="models", hint=f"known: {', '.join(models)}")
    wanted = [name for name in models if name in names or (not names and models[name][0].published)]
    own = next((models[name][0] for name in wanted if not models[name][0].published), None)
    if own is not None:
        hint = install_hint(own)
        raise UsageError("no published file is pinned, so none is fetched", where=own.name, hint=hint)
    folder = models_folder(settings.models)
    return [name for name in wanted if all(_state(folder / f.name, f) != "here" for f in models[name])]


def missing_second_look(settings: Settings, *, models: Models = MODELS) -> list[str]:
    """List the models of `SECOND_LOOK` that are not installed; none if a second look is turned off."""
    if settings.retrieval.budget_s == 0.0:
        return []
    folder = models_folder(settings.models)
    return [n for n in SECOND_LOOK if not any((folder / file.name).is_file() for file in models[n])]


def advice(settings: Settings, *, models: Models = MODELS) -> str:
    """Return a line that says which models of the second look are missing, and their benefit; else ""."""
    absent = missing_second_look(settings, models=models)
    if not absent:
        return ""
    size = sum(models[name][0].bytes for name in absent) / 1e6
    now = next(n for n in (SECOND_LOOK, ("xfeat",), ()) if not {*n} & {*absent})
    them = "it" if len(absent) == 1 else "them"
    return (
        f"{' and '.join(absent)} not installed ({size:.1f} MB): with {them}, {_BY_NIGHT[SECOND_LOOK]} % "
        f"instead of {_BY_NIGHT[now]} % of photos by night are localized correctly; "
        "run expmap models fetch, or open Server > Models as the owner"
    )


def is_available(name: str, source: Path | None, *, models: Models = MODELS) -> bool:
    """Check whether a folder has a file of a model; without a folder, whether it has a download address."""
    if source is None:
        return bool(models[name][0].address)
    return any((source / file.name).is_file() for file in models[name])


def choose_file(name: str, source: Path | None, *, models: Models = MODELS) -> ModelFile:
    """Choose which of a model's files to fetch; separate from `fetch`, to show the licence first.

    Args:
        source: Folder to copy it from; None to download it.

    Raises:
        NotFound: The folder has none of them.
        UsageError: It has no download address.
    """
    files = models[name]
    if source is None:
        if not files[0].address:
            hint = install_hint(files[0])
            raise UsageError("no trusted download address is known", where=files[0].name, hint=hint)
        return files[0]
    found = next((file for file in files if (source / file.name).is_file()), None)
    if found is None:
        wanted = " or ".join(file.name for file in files)
        raise NotFound(f"the folder has no {wanted}", where=str(source), hint=f"it is from {files[0].source}")
    return found


def fetch(file: ModelFile, source: Path | None, *, settings: Settings, progress: Progress) -> Path:
    """Download a file, or copy it from a folder; only the published file is accepted, by its hash.

    Returns:
        The file.

    Raises:
        InputError: The content differs from the published file.
    """
    if source is not None:
        came_from = str(source / file.name)
        data = atomic.read_bytes(source / file.name)
    else:
        came_from = file.address
        data = download(file.address, size=file.bytes, progress=progress)
    if not matches_hash(data, file):
        raise InputError(
            "this is not the published file, and was not kept",
            where=came_from,
            hint=f"it should have {file.bytes} bytes and SHA-256 {file.sha256}",
        )
    return _keep(data, file, settings)


def accept(model: str, source: Path, *, settings: Settings, models: Models = MODELS) -> Path:
    """Install an uploaded file, if it is a published file of the model or a network that the model can use.

    Returns:
        The installed file.

    Raises:
        NotFound: The model does not exist.
        InputError: It is neither.
        MissingPart: onnxruntime is not installed.
    """
    if model not in models:
        raise NotFound(f"unknown model {model!r}", where="models", hint="reload the page")
    data, files = read_model(source), models[model]
    if not files[0].published:
        _try(model, data)
        return _keep(data, files[0], settings)
    file = next((f for f in files if matches_hash(data, f)), None)
    if file is None:
        known = " or ".join(f.sha256 for f in files)
        raise InputError("this is not the published file", where=model, hint=f"its SHA-256 should be {known}")
    return _keep(data, file, settings)


def _try(model: str, data: bytes) -> None:
    """Open a network that the user supplies, in a folder of its own; raises InputError and MissingPart."""
    with TemporaryDirectory(prefix="expmap-model-") as folder:
        path = Path(folder) / MODELS[model][0].name
        atomic.write_bytes(path, data)
        if model == "global":
            found = global_model_problem(path.parent)
            if found:
                raise InputError(found, where=model)
        else:
            open_model(model, path.parent)


def _keep(data: bytes, file: ModelFile, settings: Settings) -> Path:
    target = models_folder(settings.models) / file.name
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"cannot be created: {error.strerror}", where=str(target.parent)) from error
    atomic.write_bytes(target, data)
    return target


def _state(path: Path, file: ModelFile) -> str:
    if not file.published:
        return "here" if path.is_file() else "missing"
    try:
        return "here" if matches_hash(path.read_bytes(), file) else "damaged"
    except OSError:
        return "missing"


_SIZE = (640, 480)
_SHAPES, _KEYPOINTS = 350, 1000
_CLOSE_PX = 3.0
"""Matches farther than this from the known warp are wrong."""


@dataclass(frozen=True, slots=True)
class ModelCheck:
    """How a model did on the pair of pictures."""

    model: str
    # `matches`, `inliers`: Matches, and those that agree with the known warp; None for a network that matches
    # nothing.
    matches: int | None
    inliers: int | None
    milliseconds: float | None  # For one picture, or for matchers the pair; None if it cannot be used
    problem: str = ""  # Why it cannot be used


def check_models(settings: Settings) -> Iterator[ModelCheck]:
    """Try each installed model once for warming up, and once more for the time."""
    pair = picture_pair()
    for model in MODELS:
        if installed(model, settings.models) is None:
            continue
        try:
            yield _check(model, pair, settings)
        except (InputError, MissingPart, StorageError) as error:
            yield ModelCheck(model, None, None, None, problem=str(error))


class PicturePair(NamedTuple):
    # `first`, `second`: (h, w) uint8
    first: NDArray[np.uint8]
    second: NDArray[np.uint8]
    warp: NDArray[np.float64]  # (3, 3) float64. From pixels of the first to those of the second.


def picture_pair() -> PicturePair:
    """Draw a picture of many shapes, and warp it."""
    rng = np.random.default_rng(0)
    width, height = _SIZE
    picture = np.full((height, width), 128, np.uint8)
    for _ in range(_SHAPES):
        centre = rng.uniform((0, 0), _SIZE)
        corners = centre + rng.normal(0.0, rng.uniform(6.0, 30.0), (rng.integers(3, 6), 2))
        cv2.fillPoly(picture, [corners.astype(np.int32)], int(rng.integers(0, 256)))
    first = np.asarray(cv2.GaussianBlur(picture, None, 0.8), np.uint8)
    turned = cv2.getRotationMatrix2D((width / 2, height / 2), 4.0, 1.05)
    warp = np.vstack([turned, [2e-5, 1e-5, 1.0]]).astype(np.float64)
    second = np.asarray(cv2.warpPerspective(first, warp, _SIZE), np.uint8)
    return PicturePair(first, second, warp)


def _check(model: str, pair: PicturePair, settings: Settings) -> ModelCheck:
    chosen = settings.models
    if model in NETWORKS:
        path, file = find_weights(model, chosen)
        detector = NETWORKS[model](checked_weights(model, path, sha256=file.sha256))
        _, spent = _timed(lambda: detector.detect(cv2.cvtColor(pair.first, cv2.COLOR_GRAY2RGB)))
        return ModelCheck(model, None, None, spent)
    if model == "global":
        described = global_descriptor(chosen)
        assert described is not None, "it is installed"
        shape = (described.height, described.width, 3)
        _, spent = _timed(lambda: described.describe(np.resize(pair.first, shape)))
        return ModelCheck(model, None, None, spent)
    features = next((name for name, matcher in PAIR_MATCHERS.items() if matcher == model), model)
    found, spent = _timed(lambda: [_extract(p, features, settings) for p in pair[:2]])
    spent /= 2
    if model in EXTRACTORS:
        pairs = _nearest(*found)
    else:
        matcher = cast(PairMatcher, open_model(model, chosen))
        pairs, spent = _timed(lambda: matcher.match(*found))
    return ModelCheck(model, len(pairs), _inliers(*found, pairs=pairs, warp=pair.warp), spent)


def _extract(picture: NDArray[np.uint8], features: str, settings: Settings) -> Features:
    choice = choose("verified", features=features)
    opened = network(choice.model, settings.models)
    return extract(picture, choice, keypoints=_KEYPOINTS, network=opened)


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    work()
    started = time.perf_counter()
    done = work()
    return done, (time.perf_counter() - started) * 1e3


def _nearest(first: Features, second: Features) -> NDArray[np.int64]:
    """Match descriptors that are nearest neighbours of each other: (m, 2) rows."""
    if not (len(first) and len(second)):
        return np.zeros((0, 2), np.int64)
    one, other = (f.descriptors.astype(np.float32) for f in (first, second))
    found = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True).match(one, other)
    return np.array([(m.queryIdx, m.trainIdx) for m in found], np.int64).reshape(-1, 2)


def _inliers(
    first: Features, second: Features, *, pairs: NDArray[np.int64], warp: NDArray[np.float64]
) -> int:
    mine = first.xy[pairs[:, 0]].astype(np.float64)
    if not len(mine):
        return 0
    there = cv2.perspectiveTransform(mine[:, None], warp)[:, 0]
    return int((np.linalg.norm(there - second.xy[pairs[:, 1]], axis=1) <= _CLOSE_PX).sum())


def queue_second_looks(library: Library, settings: Settings) -> int:
    """Queue the index job of each map whose last one ended before the models were installed.

    An index that is up to date is not built again, so a job too many does no harm.

    Returns:
        Number of maps.
    """
    if SECOND_LOOK[0] in missing_second_look(settings) or settings.retrieval.budget_s == 0.0:
        return 0
    since, count = _installed_at(settings), 0
    with library.database.write() as session:
        for id in session.scalars(select(MapRecord.id).where(MapRecord.binned_at.is_(None))).all():
            last = jobs.newest(session, id, kind=INDEX_JOB, key="")
            if last is not None and last.ended_at is not None and last.ended_at < since:
                jobs.enqueue(session, INDEX_JOB, map_id=id)
                count += 1
    return count


def _installed_at(settings: Settings) -> datetime:
    """Return when the last model of the second look was installed."""
    folder = models_folder(settings.models)
    paths = [folder / file.name for name in SECOND_LOOK for file in MODELS[name]]
    newest = max((path.stat().st_mtime for path in paths if path.is_file()), default=0.0)
    return datetime.fromtimestamp(newest, UTC)
