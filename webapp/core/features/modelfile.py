"""Model files that people bring themselves: whether one is what OpenCV's class for it takes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import cast

import cv2

from webapp.core.features.onnx import Sides, read_interface
from webapp.errors import InputError
from webapp.threads import one_at_a_time


@dataclass(frozen=True, slots=True)
class Expected:
    """What OpenCV's class wants of a model.

    Attributes
    ----------
    name : str
        Of the network, for people.
    inputs, outputs : tuple of str
    """

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def check(self, model: bytes, path: str) -> dict[str, Sides]:
        """Look at the inputs and outputs of a model.

        Parameters
        ----------
        model : bytes
            The file.
        path : str
            Where it is; people are told the file's name only.

        Returns
        -------
        dict of str to tuple of (int or None)
            The sides of each input; None where any will do.

        Raises
        ------
        InputError
            It is no such model.
        """
        try:
            inputs, outputs = read_interface(model)
        except ValueError as error:
            raise self.refused(path) from error
        if not (inputs.keys() >= set(self.inputs) and outputs >= set(self.outputs)):
            raise self.refused(path)
        return inputs

    def refused(self, path: str) -> InputError:
        """Say that a file is no such model."""
        takes, gives = ", ".join(self.inputs), ", ".join(self.outputs)
        return InputError(
            f"this is no {self.name} model that OpenCV can run",
            where=path.replace("\\", "/").rpartition("/")[2],  # the folder is nobody's business on the web
            hint=f"it takes one with the inputs {takes} and the outputs {gives}; docs/localization.md, "
            "Models that you supply, says more",
        )


def with_one_thread() -> None:
    """Leave OpenCV one thread in this process, for the sake of models whose layers nobody here has seen.

    OpenCV 5.0 computes NonZero, by which many of them pick keypoints and matches, wrongly now and then when
    several threads are at work, reads memory that nobody has written, and crashes.
    """
    cv2.setNumThreads(1)


@one_at_a_time
@contextmanager
def quietly() -> Iterator[None]:
    """Keep OpenCV from writing to the terminal what it thinks of a model; what matters it raises."""
    before = cast(int, cv2.utils.logging.getLogLevel())
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)
