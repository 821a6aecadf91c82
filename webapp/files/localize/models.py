"""Models of networks: their files, and the networks made of them.

Published files are identified by their hash. Others are supplied by the user: only their name is fixed, and
their hash becomes part of an index's name. The global descriptor is `global.onnx`; `global.json` next to it
states what the model does not: `width`, `height`, `mean` and `std` of its input.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from platformdirs import user_cache_path

from webapp.core.detections import LpdYuNet, ObjectDetector, YuNet
from webapp.core.features.entry import ModelFile, supplied_file
from webapp.core.features.global_descriptor import GlobalDescriptor, InputForm, read_form
from webapp.core.features.lightglue import PairMatcher
from webapp.core.features.table import (
    BUNDLES,
    EXTRACTORS,
    LANDMARK_FEATURES,
    METHODS,
    PAIR_MATCHERS,
    FeatureChoice,
    Method,
    choose,
)
from webapp.errors import ExpMapError, InputError, MissingPart, StorageError, UsageError
from webapp.extras import is_installed
from webapp.files.atomic import read_bytes

SUFFIX = ".onnx"

_MOST_BYTES = 2**31 - 1
"""Limit of Protocol Buffers, in which ONNX files are written."""

_FETCH = "run expmap models fetch"


_NETWORKS = {e.model.name: e.model for e in EXTRACTORS.values() if e.model}
_MATCHERS = {e.pair_matcher.name: e.pair_matcher for e in EXTRACTORS.values() if e.pair_matcher}

_OTHERS: dict[str, tuple[ModelFile, ...]] = {
    "faces": (
        ModelFile(
            name="face_detection_yunet_2023mar.onnx",
            bytes=232_589,
            sha256="8f2383e4dd3cfbb4553ea8718107fc0423210dc964f9f4280604804ed2552fa4",
            licence="MIT",
            source="YuNet of github.com/opencv/opencv_zoo, which finds faces",
            address="https://media.githubusercontent.com/media/opencv/opencv_zoo/main/models/"
            "face_detection_yunet/face_detection_yunet_2023mar.onnx",
        ),
    ),
    "plates": (
        ModelFile(
            name="license_plate_detection_lpd_yunet_2023mar.onnx",
            bytes=4_146_213,
            sha256="6d4978a7b6d25514d5e24811b82bfb511d166bdd8ca3b03aa63c1623d4d039c7",
            licence="Apache-2.0",
            source="LPD-YuNet of github.com/opencv/opencv_zoo, which finds number plates, best Chinese ones",
            address="https://media.githubusercontent.com/media/opencv/opencv_zoo/"
            "b4971d625240509dae6119e19201fe30919a285f/models/license_plate_detection_yunet/"
            "license_plate_detection_lpd_yunet_2023mar.onnx",
        ),
    ),
    "global": (supplied_file("global.onnx", "a global descriptor, such as MegaLoc, SALAD or EigenPlaces"),),
}

_FILES = {name: entry.files for name, entry in (_NETWORKS | _MATCHERS).items()} | _OTHERS

MODELS = dict(sorted(_FILES.items(), key=lambda item: not item[1][0].published))
"""By model: files with the same weights, any one of which is enough. Published ones come first."""


def models_folder(chosen: Path | None) -> Path:
    """Return the folder of the weights: the chosen one, or else one in the user's cache."""
    return chosen or user_cache_path("experience-map") / "models"


def matches_hash(data: bytes, file: ModelFile) -> bool:
    """Check whether bytes are those of a published file; True for any file that the user supplies."""
    if not file.published:
        return True
    return len(data) == file.bytes and hashlib.sha256(data).hexdigest() == file.sha256


def install_hint(file: ModelFile) -> str:
    """Return the instruction to get a file, without naming the folder, which is private on a server."""
    if file.address:
        return _FETCH
    if file.published:
        return f"copy {file.name} from a folder that has it: expmap models fetch --from FOLDER"
    return (
        f"you have to supply it yourself: put it as {file.name} into the folder that expmap models list "
        "prints; see 'Models that you supply' in docs/features.md"
    )


def installed(model: str, chosen: Path | None) -> ModelFile | None:
    """Find a file of a model that has the right size; its content is checked when it is opened."""
    folder = models_folder(chosen)
    for file in MODELS[model]:
        size = _size(folder / file.name)
        if size is not None and size == (file.bytes if file.published else size):
            return file
    return None


def is_usable(choice: FeatureChoice, chosen: Path | None, *, method: Method) -> bool:
    """Check whether all models that a method needs with these features are installed."""
    models = [choice.model, PAIR_MATCHERS[choice.name] if method == "thorough" else None]
    needed = [model for model in models if model]
    return not needed or (is_installed("learned") and all(installed(model, chosen) for model in needed))


def usable_features(chosen: Path | None, *, method: Method = "verified") -> list[str]:
    """List the bundles of features that suit a method and whose models are installed."""
    fitting: Iterable[str] = BUNDLES
    if method == "thorough":
        fitting = PAIR_MATCHERS
    elif method == "landmarks":
        fitting = (LANDMARK_FEATURES,)
    return [name for name in fitting if is_usable(choose(method, features=name), chosen, method=method)]


def second_look_features(chosen: Path | None) -> str | None:
    """Choose the features of the second look of method `auto`; None if no model for it is installed.

    Features whose matching network is installed, too, are preferred.
    """
    here = [name for name in PAIR_MATCHERS if name in usable_features(chosen)]
    matched = usable_features(chosen, method="thorough")
    return min(here, key=lambda name: name not in matched, default=None)


def usable_methods(chosen: Path | None) -> list[Method]:
    """List the methods whose models for the default features are installed."""
    return [method for method in METHODS if is_usable(choose(method), chosen, method=method)]


def with_weights(choice: FeatureChoice, chosen: Path | None, *, method: Method) -> FeatureChoice:
    """Open the models that a method needs, and record the hash of a file that the user supplied.

    Raises:
        MissingPart: A file is not installed, or is not the expected one.
        InputError: The user's file holds another kind of network.
        StorageError: A file cannot be read.
    """
    if method == "thorough":
        pair_matcher(choice.name, chosen)
    if choice.model is None:
        return choice
    path, file = find_weights(choice.model, chosen)
    if not file.published:
        choice = replace(choice, weights=hashlib.sha256(read_model(path)).hexdigest())
    network(choice.model, chosen, weights=choice.weights)
    return choice


def network(model: str | None, chosen: Path | None, *, weights: str = "") -> object | None:
    """Open a feature network, once per process.

    Args:
        model: `FeatureChoice.model`; None if the features need none.
        weights: `FeatureChoice.weights`: the hash that a file supplied by the user must have.

    Raises:
        MissingPart: The weights are not installed, or are not the expected ones.
        InputError: The user's file holds another kind of network.
        StorageError: They cannot be read.
    """
    if model is None:
        return None
    path, file = find_weights(model, chosen)
    return _network(model, path, file.sha256 or weights or hashlib.sha256(read_model(path)).hexdigest())


def pair_matcher(features: str, chosen: Path | None) -> PairMatcher:
    """Open the network that matches features of two photos, once per process.

    Raises:
        UsageError: There is no network for these features.
        MissingPart, InputError, StorageError: As for `network`.
    """
    model = PAIR_MATCHERS.get(features)
    if model is None:
        fitting = " or ".join(PAIR_MATCHERS)
        raise UsageError(
            f"no network matches features {features}", where="--features", hint=f"use --features {fitting}"
        )
    path, file = find_weights(model, chosen)
    return _matcher(model, path, file.sha256 or hashlib.sha256(read_model(path)).hexdigest())


def pair_matcher_if_installed(features: str, chosen: Path | None) -> PairMatcher | None:
    """Open the network that matches features of two photos; None if there is none or it is not installed."""
    model = PAIR_MATCHERS.get(features)
    if model is None or not is_installed("learned") or installed(model, chosen) is None:
        return None
    return pair_matcher(features, chosen)


def open_model(model: str, chosen: Path | None) -> object:
    """Open the features network or matching network of a model; raises as `network` does."""
    if model in _NETWORKS:
        return network(model, chosen)
    path, file = find_weights(model, chosen)
    return _matcher(model, path, file.sha256 or hashlib.sha256(read_model(path)).hexdigest())


def find_weights(model: str, chosen: Path | None) -> tuple[Path, ModelFile]:
    """Find the installed file of a model; its content is not checked yet."""
    file = installed(model, chosen)
    if file is None:
        hint = install_hint(MODELS[model][0])
        raise MissingPart(f"the weights of {model} are not installed", where="models", hint=hint)
    return models_folder(chosen) / file.name, file


@lru_cache(maxsize=4)
def _network(model: str, path: Path, sha256: str) -> object:
    return _NETWORKS[model].load(checked_weights(model, path, sha256=sha256), path.name)


@lru_cache(maxsize=2)
def _matcher(model: str, path: Path, sha256: str) -> PairMatcher:
    return _MATCHERS[model].load(checked_weights(model, path, sha256=sha256), path.name)  # type: ignore[no-any-return]


def checked_weights(model: str, path: Path, *, sha256: str) -> bytes:
    """Read a file of a model, and check its hash."""
    data = read_model(path)
    if hashlib.sha256(data).hexdigest() == sha256:
        return data
    published = next((file for file in MODELS[model] if file.sha256 == sha256), None)
    if published is not None:
        raise MissingPart("the file is not the published one", where=path.name, hint=install_hint(published))
    raise MissingPart(
        "the file has changed since the map was opened",
        where=path.name,
        hint="run expmap build on the map, and restart the server",
    )


def read_model(path: Path) -> bytes:
    if (_size(path) or 0) > _MOST_BYTES:
        raise InputError(
            f"it has more than {_MOST_BYTES / 1e9:.1f} GB, so it is not an ONNX file", where=path.name
        )
    return read_bytes(path)


def _size(path: Path) -> int | None:
    try:
        return path.stat().st_size
    except OSError:
        return None


NETWORKS: dict[str, type[YuNet] | type[LpdYuNet]] = {"faces": YuNet, "plates": LpdYuNet}
"""By model name."""


@dataclass(frozen=True, slots=True)
class BlurNetworks:
    detectors: tuple[ObjectDetector, ...]
    key: str  # Identifies the set of networks, and so their results
    missing: tuple[str, ...]  # Models that are not installed


def blur_networks(chosen: Path | None) -> BlurNetworks:
    """Open the networks that detect faces and number plates, each once per process.

    Raises:
        MissingPart: None is installed, or a file is not the published one.
        StorageError: A file cannot be read.
    """
    missing = missing_networks(chosen)
    if len(missing) == len(NETWORKS):
        raise MissingPart(
            "no network that finds faces or number plates is installed",
            where="models",
            hint=f"the administrator of the server can install them: expmap models fetch {' '.join(missing)}",
        )
    files = {model: find_weights(model, chosen) for model in NETWORKS if model not in missing}
    detectors = tuple(_opened(model, path, file.sha256) for model, (path, file) in files.items())
    key = "-".join(file.sha256[:8] for _, file in files.values())
    return BlurNetworks(detectors, key, missing)


def missing_networks(chosen: Path | None) -> tuple[str, ...]:
    return tuple(model for model in NETWORKS if installed(model, chosen) is None)


@lru_cache(maxsize=2)
def _opened(model: str, path: Path, sha256: str) -> ObjectDetector:
    return NETWORKS[model](checked_weights(model, path, sha256=sha256))


_State = tuple[int, int] | None
"""Modification time and size of a file; None if it is missing."""


def global_descriptor(chosen: Path | None) -> GlobalDescriptor | None:
    """Open the model, once per process while its files do not change; None if there is none.

    Raises:
        InputError: The file holds another kind of network, or the JSON next to it is invalid.
        MissingPart: onnxruntime is not installed.
        StorageError: A file cannot be read.
    """
    model, form = global_model_paths(chosen)
    seen = _state_of(model)
    if seen is None:
        return None
    opened = _open(model, seen, _state_of(form))
    if isinstance(opened, ExpMapError):
        raise opened.with_traceback(None)
    return opened


def usable_global_descriptor(chosen: Path | None) -> GlobalDescriptor | None:
    """Open the model; None if it is missing or unusable (`problem` returns why)."""
    try:
        return global_descriptor(chosen)
    except (InputError, MissingPart, StorageError):
        return None


def global_model_problem(chosen: Path | None) -> str:
    """Try the model; return a sentence why it is unusable, or an empty string (also if it is missing)."""
    try:
        network = global_descriptor(chosen)
        if network is not None:
            across = np.linspace(0, 255, network.width).astype(np.uint8)
            network.describe(np.broadcast_to(across[None, :, None], (network.height, network.width, 3)))
    except (InputError, MissingPart, StorageError) as error:
        return str(error)
    return ""


def global_model_paths(chosen: Path | None) -> tuple[Path, Path]:
    """Return the paths of the model and of the JSON about its input."""
    path = models_folder(chosen) / MODELS["global"][0].name
    return path, path.with_suffix(".json")


@lru_cache(maxsize=2)
def _open(model: Path, seen: _State, form_seen: _State) -> GlobalDescriptor | ExpMapError:
    """Open the files in the state seen; errors are returned, so that they are cached, too."""
    try:
        data = read_model(model)
        form = _form(model.with_suffix(".json")) if form_seen is not None else InputForm()
        weights = hashlib.sha256(hashlib.sha256(data).digest() + repr(form).encode()).hexdigest()[:16]
        return GlobalDescriptor(data, file=model.name, form=form, weights=weights)
    except (InputError, MissingPart, StorageError) as error:
        return error


def _form(path: Path) -> InputForm:
    try:
        return read_form(json.loads(read_bytes(path)))
    except (ValueError, RecursionError) as error:
        reason = "it is not JSON" if isinstance(error, json.JSONDecodeError | UnicodeError) else str(error)
        hint = (
            'as in {"width": 322, "height": 322, "mean": [0.485, 0.456, 0.406], "std": [0.229, 0.224, 0.225]}'
        )
        raise InputError(reason, where=path.name, hint=hint) from error


def _state_of(path: Path) -> _State:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
