"""Global descriptors: one vector for a whole photo, similar for photos of one place.

The network is a file that the user supplies, such as MegaLoc (Berton and Masone 2025), SALAD (Izquierdo and
Civera 2024) or EigenPlaces (Berton et al. 2023).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.network import Interface, Network
from webapp.errors import InputError

Triple = tuple[float, float, float]

_MEAN: Triple = (0.485, 0.456, 0.406)
_STD: Triple = (0.229, 0.224, 0.225)
"""Statistics of ImageNet, red, green and blue from 0 to 1, with which most such networks are trained."""

_LEAST_SIDE, _MOST_SIDE = 8, 2048
"""Limits of the sides of a network's input images, pixels."""

_LEAST_STD, _MOST = 1e-3, 1e3
"""Limits of means and standard deviations: other values are mistakes, or 0."""

_HINT = "see 'A global descriptor' in docs/features.md"

_INTERFACE = Interface("global descriptor", (), (), needs=_HINT)


@dataclass(frozen=True, slots=True)
class InputForm:
    """How a photo is converted to the input of a network; None if not stated."""

    # `width`, `height`: Pixels to which the whole photo is scaled.
    width: int | None = None
    height: int | None = None
    # `mean`, `std`: Of red, green and blue from 0 to 1: the mean is subtracted, and the result divided by
    # `std`.
    mean: Triple | None = None
    std: Triple | None = None


_NAMES = tuple(field.name for field in fields(InputForm))


def read_form(stated: object) -> InputForm:
    """Parse an input form from the values of a JSON file.

    Raises:
        ValueError: A field is unknown or its value is not valid; the message names it.
    """
    if not isinstance(stated, Mapping):
        raise ValueError("it is not an object")
    unknown = next((name for name in stated if name not in _NAMES), None)
    if unknown is not None:
        raise ValueError(f"unknown field {unknown!r}; known: {', '.join(_NAMES)}")
    return InputForm(
        width=_side("width", stated.get("width")),
        height=_side("height", stated.get("height")),
        mean=_triple("mean", stated.get("mean"), least=-_MOST),
        std=_triple("std", stated.get("std"), least=_LEAST_STD),
    )


def _side(name: str, value: object) -> int | None:
    if value is None:
        return None
    if not isinstance(value, int) or isinstance(value, bool) or not _LEAST_SIDE <= value <= _MOST_SIDE:
        raise ValueError(f"{name} is not a whole number from {_LEAST_SIDE} to {_MOST_SIDE}")
    return value


def _triple(name: str, value: object, *, least: float) -> Triple | None:
    if value is None:
        return None
    numbers = value if isinstance(value, list) else []
    if len(numbers) != 3 or not all(_is_number(n) and least <= n <= _MOST for n in numbers):
        raise ValueError(f"{name} is not a list of three numbers from {least:g} to {_MOST:g}")
    red, green, blue = map(float, numbers)
    return red, green, blue


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


class GlobalDescriptor:
    """A network that describes a whole photo; threads may share it.

    Args:
        model: Content of an ONNX file with one input, (1, 3, height, width), and one output, (1, d). Values
            that the form does not state are read from its shape and metadata; the default normalisation is
            ImageNet's.
        weights: Identifies the content of the model file and the form.
    """

    def __init__(self, model: bytes, *, file: str, form: InputForm, weights: str) -> None:
        self.weights = weights
        self._file = file
        self._network = Network(model, _INTERFACE, file=file)
        own = self._own_size()
        self._check_output()
        forms = (form, self._metadata())
        self.width = self._one_side("width", own[0], forms)
        self.height = self._one_side("height", own[1], forms)
        means, stds = [f.mean for f in forms if f.mean], [f.std for f in forms if f.std]
        self._mean = np.array([*means, _MEAN][0], np.float32)
        self._std = np.array([*stds, _STD][0], np.float32)

    def describe(self, photo: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Describe an upright photo.

        Args:
            photo: (h, w, 3) uint8. Blue, green, red.

        Returns:
            (d,) float32: Of length 1.

        Raises:
            InputError: The model fails, or its output is not one finite, non-zero vector.
        """
        smaller = self.width * self.height < photo.shape[0] * photo.shape[1]
        how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
        scaled = cv2.resize(photo, (self.width, self.height), interpolation=how)
        colours = cv2.cvtColor(scaled, cv2.COLOR_BGR2RGB).astype(np.float32) / np.float32(255.0)
        image = np.ascontiguousarray(((colours - self._mean) / self._std).transpose(2, 0, 1)[None])
        (name,) = self._network.inputs
        found = self._network.run(**{name: image})[0]
        if found.ndim not in (1, 2) or found.size != found.shape[-1]:
            raise self._error(f"it gives an array of shape {found.shape} instead of one vector")
        vector = found.reshape(-1).astype(np.float32)
        length = float(np.linalg.norm(vector))
        if not math.isfinite(length) or length == 0.0:
            raise self._error("its vectors are zero or contain values that are not finite")
        return np.asarray(vector / np.float32(length), np.float32)

    def _own_size(self) -> tuple[int | None, int | None]:
        """Read width and height from the shape of the model's input; None if not fixed."""
        shapes = [*self._network.inputs.values()]
        if len(shapes) != 1:
            raise self._error(f"it has {len(shapes)} inputs instead of one image")
        shape = shapes[0]
        if len(shape) != 4 or shape[0] not in (1, None) or shape[1] not in (3, None):
            raise self._error(f"its input has the shape {_shown(shape)} instead of (1, 3, height, width)")
        return shape[3], shape[2]

    def _check_output(self) -> None:
        shapes = [*self._network.outputs.values()]
        if len(shapes) != 1:
            raise self._error(f"it has {len(shapes)} outputs instead of one vector")
        if len(shapes[0]) > 2:
            raise self._error(f"its output has the shape {_shown(shapes[0])} instead of (1, d)")

    def _metadata(self) -> InputForm:
        """Read the input form from the model's metadata."""
        stated = {name: text for name, text in self._network.metadata.items() if name in _NAMES}
        try:
            return read_form({name: json.loads(text) for name, text in stated.items()})
        except ValueError as error:
            raise self._error(f"its metadata is wrong: {error}") from error

    def _one_side(self, name: str, own: int | None, forms: tuple[InputForm, ...]) -> int:
        stated = next((side for form in forms if (side := getattr(form, name))), None)
        if own and stated and own != stated:
            raise self._error(f"its input {name} is {own}, but {stated} is stated")
        if not (own or stated):
            raise self._error(f"its input {name} is not fixed, and none is stated")
        return int(own or stated or 0)

    def _error(self, message: str) -> InputError:
        return InputError(f"not a global descriptor: {message}", where=self._file, hint=_HINT)


def _shown(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('any' if side is None else str(side) for side in shape)})"
