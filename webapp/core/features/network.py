"""Networks in ONNX files, run by onnxruntime on the CPU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.errors import InputError
from webapp.extras import extra

Sides = tuple[int | None, ...]
"""Shape of an array; None for sides that are not fixed."""

_ONE_FILE = ("session.model_external_initializers_file_folder_path", "/dev/null")
"""Option of onnxruntime: weights in other files are looked for where there are none. By default it reads
files in the current folder that the model names; they would not be part of the model's hash."""

_SILENT = 4
"""Minimum severity of onnxruntime's log messages (fatal): errors are raised as exceptions anyway."""


@dataclass(frozen=True, slots=True)
class Interface:
    """Inputs and outputs that a network must have."""

    name: str  # Name of the network, for messages
    # `inputs`, `outputs`: Their names; empty if there are no requirements.
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    needs: str = ""  # Hint for the requirements on a file, if they do not follow from the names

    def error(self, file: str) -> InputError:
        """Create the error for a file that does not contain this network."""
        names = (
            f"it needs the inputs {', '.join(self.inputs)} and the outputs {', '.join(self.outputs)}; "
            "see 'Models that you supply' in docs/features.md"
        )
        message = f"not a {self.name} model that onnxruntime can run"
        return InputError(message, where=file, hint=self.needs or names)


class Network:
    """A network with its weights; threads may share it.

    It uses as many native threads as OpenCV may in this process (`cv2.setNumThreads`).

    Attributes:
        inputs, outputs: dict of str to tuple of (int or None). Shape of each input and output.
        metadata: Custom metadata of the file.

    Raises:
        InputError: onnxruntime cannot open the model, its weights are in other files, or it has other inputs
            or outputs.
        MissingPart: onnxruntime is not installed.
    """

    def __init__(self, model: bytes, interface: Interface, *, file: str) -> None:
        with extra("learned"):
            import onnxruntime
        self._interface, self._file = interface, file
        self._errors = _errors_of(onnxruntime)
        options = onnxruntime.SessionOptions()
        options.log_severity_level = _SILENT
        options.intra_op_num_threads = cv2.getNumThreads()
        options.inter_op_num_threads = 1
        # Memory plans are kept for each input shape, and photos have many.
        options.enable_mem_pattern = False
        # Threads that wait in a busy loop take CPU time from other processes.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        options.add_session_config_entry(*_ONE_FILE)
        try:
            self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        except self._errors as error:
            raise _unusable(error, interface, file=file) from error
        self.inputs: dict[str, Sides] = {i.name: _sides(i.shape) for i in self._session.get_inputs()}
        self.outputs: dict[str, Sides] = {o.name: _sides(o.shape) for o in self._session.get_outputs()}
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        if not (self.inputs.keys() >= {*interface.inputs} and self.outputs.keys() >= {*interface.outputs}):
            raise interface.error(file)

    def run(self, **inputs: NDArray[np.float32]) -> list[NDArray[Any]]:
        """Run the network.

        Args:
            **inputs: float32. By name.

        Returns:
            list of array: The outputs of the interface, in its order, or all if it names none.
        """
        try:
            names = [*(self._interface.outputs or self.outputs)]
            found: list[NDArray[Any]] = self._session.run(names, inputs)
        except self._errors as error:
            raise self.error() from error
        return found

    def error(self) -> InputError:
        """Create the error for outputs that do not fit the interface."""
        return self._interface.error(self._file)


def _unusable(error: Exception, interface: Interface, *, file: str) -> InputError:
    if "external data path" in str(error).lower():
        hint = "export it as one file: external_data=False of torch.onnx.export"
        return InputError("its weights are in another file, which is not read", where=file, hint=hint)
    return interface.error(file)


def _errors_of(onnxruntime: Any) -> tuple[type[Exception], ...]:
    """List the exceptions that onnxruntime raises, which have no common base class."""
    kinds: Mapping[str, object] = vars(onnxruntime.capi.onnxruntime_pybind11_state)
    own = (kind for kind in kinds.values() if isinstance(kind, type) and issubclass(kind, Exception))
    return (*own, RuntimeError, ValueError)


def _sides(shape: list[int | str | None]) -> Sides:
    return tuple(side if isinstance(side, int) and side > 0 else None for side in shape)
