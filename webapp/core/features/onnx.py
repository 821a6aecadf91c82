"""The little of the ONNX format (protocol buffers) that it takes to read weights and to write a network.

Only what is needed here: what a model takes and gives, convolutions with their weights in, a graph of a few
kinds of layers out. The numbers of the fields are those of `onnx.proto3`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Attributes = Mapping[str, str | list[int]]
"""Of a node."""

_FLOAT, _INT, _STRING, _INTS = 1, 2, 3, 7
_OPSET = 11

_PRODUCT = r"(\w*)(\w)(\w),\1\3(\w)->\1\2\4"
_WITH_TRANSPOSE = r"(\w*)(\w)(\w),\1(\w)\3->\1\2\4"
"""Equations of an Einsum; no letter may stand for two sides."""

_MOST_SIDE = 1 << 31
"""Numbers that are larger stand for negative ones, which mean that the side is not fixed."""


class Convolution(NamedTuple):
    """Weight (out, in, k, k) and bias (out,), float32."""

    weight: NDArray[np.float32]
    bias: NDArray[np.float32]


def read_convolutions(data: bytes) -> dict[str, Convolution]:
    """Read the weights of all convolutions of a model, in the order in which they are computed.

    Parameters
    ----------
    data : bytes
        A model that is known to be whole: nothing is checked.

    Returns
    -------
    dict of str to Convolution
        By the name of their output.
    """
    graph = _Message(_Message(data).parts[7][0])
    tensors = dict(_tensor(_Message(part)) for part in graph.parts[5])
    found = {}
    for node in map(_Message, graph.parts[1]):
        if node.texts(4) == ["Conv"]:
            _, weight, bias = node.texts(1)
            found[node.texts(2)[0]] = Convolution(tensors[weight], tensors[bias])
    return found


Sides = tuple[int | None, ...]
"""Of an array; None where any will do."""


def read_interface(data: bytes) -> tuple[dict[str, Sides], set[str]]:
    """Read what a model takes and gives.

    Parameters
    ----------
    data : bytes
        A file that may be anything.

    Returns
    -------
    dict of str to tuple of (int or None)
        The sides of each input.
    set of str
        Names of the outputs.

    Raises
    ------
    ValueError
        It is no such model.
    """
    try:
        graph = _Message(_Message(data).parts[7][0])
        inputs = [_Message(part) for part in graph.parts[11]]
        outputs = [_Message(part) for part in graph.parts[12]]
        return {i.texts(1)[0]: _sides(i) for i in inputs}, {o.texts(1)[0] for o in outputs}
    except IndexError as error:
        raise ValueError("a part of the model is missing") from error


def _sides(declared: _Message) -> Sides:
    shape = _Message(_Message(_Message(declared.parts[2][0]).parts[1][0]).parts[2][0])
    numbers = [_Message(side).numbers[1] for side in shape.parts[1]]
    return tuple(n[0] if n and 0 < n[0] < _MOST_SIDE else None for n in numbers)


def _tensor(message: _Message) -> tuple[str, NDArray[np.float32]]:
    raw = message.parts[9][0] if message.parts[9] else b""
    return message.texts(8)[0], np.frombuffer(raw, "<f4").reshape(message.numbers[1])


def with_products(model: bytes) -> bytes:
    """Write each Einsum of a model that is a product of matrices, or with another's transpose, as such.

    OpenCV 5.0 computes an Einsum for the sizes only that it sees first, and such products for all.

    Raises
    ------
    ValueError
        It is no model.
    """
    try:
        whole = _Message(model)
        graph = _Message(whole.parts[7][0])
        graph.parts[1] = [memoryview(part) for node in graph.parts[1] for part in _as_product(node)]
    except IndexError as error:
        raise ValueError("a part of the model is missing") from error
    whole.parts[7] = [memoryview(graph.to_bytes())]
    return whole.to_bytes()


def cut_after(model: bytes, layers: Sequence[str]) -> bytes:
    """Make some layers of a model its outputs, and leave out what comes after them.

    Parameters
    ----------
    model : bytes
        A model that is known to be whole.
    layers : sequence of str
        Outputs of its nodes.
    """
    whole = _Message(model)
    graph = _Message(whole.parts[7][0])
    needed, kept = {*layers}, []
    for node in reversed(graph.parts[1]):
        message = _Message(node)
        if needed.intersection(message.texts(2)):
            kept.append(node)
            needed.update(message.texts(1))
    graph.parts[1] = kept[::-1]
    kind = _field(2, _field(1, _field(1, _FLOAT) + _field(2, b"")))
    graph.parts[12] = [memoryview(_field(1, name.encode()) + kind) for name in layers]
    whole.parts[7] = [memoryview(graph.to_bytes())]
    return whole.to_bytes()


def _as_product(node: memoryview) -> list[bytes]:
    """Give the nodes that stand for a node: itself, or what computes the same Einsum."""
    message = _Message(node)
    if message.texts(4) != ["Einsum"]:
        return [bytes(node)]
    equation = _Message(message.parts[5][0]).texts(4)[0].replace(" ", "")
    inputs, output = message.texts(1), message.texts(2)[0]
    if _is(_PRODUCT, equation):
        return [_node("MatMul", output, inputs=inputs)]
    if not _is(_WITH_TRANSPOSE, equation):
        return [bytes(node)]
    batch = len(equation.split(",")[0]) - 2
    order = {"perm": [*range(batch), batch + 1, batch]}
    turned = f"{output}.transposed"
    return [
        _node("Transpose", turned, inputs=inputs[1:], attributes=order),
        _node("MatMul", output, inputs=[inputs[0], turned]),
    ]


def _is(form: str, equation: str) -> bool:
    found = re.fullmatch(form, equation)
    return found is not None and len({*"".join(found.groups())}) == len("".join(found.groups()))


class _Message:
    """What is in a message: by the number of the field, its numbers, and its parts of other kinds."""

    def __init__(self, data: bytes | memoryview) -> None:
        self.numbers: dict[int, list[int]] = defaultdict(list)
        self.parts: dict[int, list[memoryview]] = defaultdict(list)
        view, at = memoryview(data), 0
        while at < len(view):
            key, at = _number(view, at)
            field, kind = key >> 3, key & 7
            if kind == 0:
                value, at = _number(view, at)
                self.numbers[field].append(value)
            else:
                size, at = _number(view, at) if kind == 2 else (8 if kind == 1 else 4, at)
                self.parts[field].append(view[at : at + size])
                at += size

    def texts(self, field: int) -> list[str]:
        """Read the parts of a field as text."""
        return [bytes(part).decode() for part in self.parts[field]]

    def to_bytes(self) -> bytes:
        """Write a message whose parts are texts, bytes and messages."""
        numbers = b"".join(_field(field, n) for field, values in self.numbers.items() for n in values)
        return numbers + b"".join(
            _field(field, bytes(p)) for field, parts in self.parts.items() for p in parts
        )


def _number(view: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = view[at]
        at += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, at
        if shift > 63:
            raise ValueError("a number has too many digits")


class Graph:
    """A network that is put together layer by layer; each method gives the name of its layer's output."""

    def __init__(self) -> None:
        self._nodes: list[bytes] = []
        self._tensors: list[bytes] = []
        self._inputs: list[bytes] = []

    def input(self, name: str, channels: int) -> str:
        """Declare an input of shape (1, channels, any, any)."""
        self._inputs.append(_declared(name, channels))
        return name

    def convolution(self, name: str, source: str, *, of: Convolution, stride: int = 1, relu: bool) -> str:
        """Add a convolution that keeps the size, divided by `stride`."""
        side = of.weight.shape[2]
        weight, bias = self._tensor(f"{name}.weight", of.weight), self._tensor(f"{name}.bias", of.bias)
        shape = {"kernel_shape": [side] * 2, "strides": [stride] * 2, "pads": [side // 2] * 4}
        output = self._node("Conv", name, inputs=[source, weight, bias], attributes=shape)
        return self._node("Relu", f"{name}.relu", inputs=[output]) if relu else output

    def sum(self, name: str, *, of: tuple[str, str]) -> str:
        """Add two layers of one shape."""
        return self._node("Add", name, inputs=of)

    def enlarge(self, name: str, source: str, *, times: int) -> str:
        """Interpolate to `times` the width and height, bilinearly between pixel centres."""
        scales = self._tensor(f"{name}.scales", np.array([1, 1, times, times], np.float32))
        how = {"coordinate_transformation_mode": "half_pixel", "mode": "linear"}
        return self._node("Resize", name, inputs=[source, "", scales], attributes=how)

    def sigmoid(self, name: str, source: str) -> str:
        """Squeeze every number between 0 and 1."""
        return self._node("Sigmoid", name, inputs=[source])

    def to_bytes(self, outputs: Sequence[tuple[str, int]]) -> bytes:
        """Write the model; `outputs` are layers with their numbers of channels."""
        graph = b"".join(_field(1, n) for n in self._nodes) + _field(2, b"graph")
        graph += b"".join(_field(5, t) for t in self._tensors) + b"".join(_field(11, i) for i in self._inputs)
        graph += b"".join(_field(12, _declared(*output)) for output in outputs)
        return _field(1, 6) + _field(8, _field(2, _OPSET)) + _field(7, graph)

    def _tensor(self, name: str, values: NDArray[np.float32]) -> str:
        shape = b"".join(_field(1, side) for side in values.shape)
        raw = values.astype("<f4").tobytes()
        self._tensors.append(shape + _field(2, _FLOAT) + _field(8, name.encode()) + _field(9, raw))
        return name

    def _node(
        self,
        kind: str,
        name: str,
        *,
        inputs: Sequence[str],
        attributes: Attributes = MappingProxyType({}),
    ) -> str:
        self._nodes.append(_node(kind, name, inputs=inputs, attributes=attributes))
        return name


def _node(
    kind: str, name: str, *, inputs: Sequence[str], attributes: Attributes = MappingProxyType({})
) -> bytes:
    """Write a node; its output has its name."""
    node = b"".join(_field(1, i.encode()) for i in inputs)
    node += _field(2, name.encode()) + _field(3, name.encode()) + _field(4, kind.encode())
    for key, value in attributes.items():
        if isinstance(value, str):
            content, form = _field(4, value.encode()), _STRING
        else:
            content, form = b"".join(_field(8, v) for v in value), _INTS
        node += _field(5, _field(1, key.encode()) + content + _field(20, form))
    return node


def _declared(name: str, channels: int) -> bytes:
    sides = [_field(1, 1), _field(1, channels), _field(2, b"height"), _field(2, b"width")]
    shape = b"".join(_field(1, side) for side in sides)
    return _field(1, name.encode()) + _field(2, _field(1, _field(1, _FLOAT) + _field(2, shape)))


def _field(number: int, value: int | bytes) -> bytes:
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    return _varint(number << 3 | 2) + _varint(len(value)) + value


def _varint(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)
