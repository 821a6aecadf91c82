"""Writes small ONNX models with any layers, as stand-ins for published ones (fields as in onnx.proto3)."""

import numpy as np

FLOAT, INT64 = 1, 7
OPSET = 13


class Writer:
    """A model built node by node; each method returns the name of what it added."""

    def __init__(self):
        self._parts = [field(2, b"graph")]
        self._metadata = b""
        self._count = 0

    def input(self, name, *shape, kind=FLOAT):
        """Declare an input; a dimension given as text is dynamic."""
        self._parts.append(field(11, _declared(name, shape, kind)))
        return name

    def output(self, name, *shape, kind=FLOAT):
        self._parts.append(field(12, _declared(name, shape, kind)))

    def constant(self, values):
        """Add an array, float32 or int64."""
        array, name = np.asarray(values), self._name()
        kind, form = (INT64, "<i8") if array.dtype.kind == "i" else (FLOAT, "<f4")
        shape = b"".join(field(1, side) for side in array.shape)
        tensor = shape + field(2, kind) + field(8, name.encode()) + field(9, array.astype(form).tobytes())
        self._parts.append(field(5, tensor))
        return name

    def add_initializer(self, tensor):
        """Add an encoded TensorProto."""
        self._parts.append(field(5, tensor))

    def node(self, kind, *inputs, name=None, outputs=1, **attributes):
        """Add a node; several outputs are a list. Attributes are integers, lists of them, or texts."""
        names = [name] if name else [self._name() for _ in range(outputs)]
        node = b"".join(field(1, name.encode()) for name in inputs)
        node += b"".join(field(2, name.encode()) for name in names)
        node += field(3, self._name().encode()) + field(4, kind.encode())
        for key, value in attributes.items():
            if isinstance(value, int):
                content, form = field(3, value), 2
            elif isinstance(value, str):
                content, form = field(4, value.encode()), 3
            else:
                content, form = b"".join(field(8, v) for v in value), 7
            node += field(5, field(1, key.encode()) + content + field(20, form))
        self._parts.append(field(1, node))
        return names[0] if outputs == 1 else names

    def metadata(self, key, value):
        """Add an entry to the model's metadata."""
        self._metadata += field(14, field(1, key.encode()) + field(2, value.encode()))

    def to_bytes(self):
        return field(1, 8) + field(8, field(2, OPSET)) + field(7, b"".join(self._parts)) + self._metadata

    def _name(self):
        self._count += 1
        return f"n{self._count}"


def _declared(name, shape, kind):
    sides = (field(2, side.encode()) if isinstance(side, str) else field(1, side) for side in shape)
    dims = b"".join(field(1, side) for side in sides)
    return field(1, name.encode()) + field(2, field(1, field(1, kind) + field(2, dims)))


def field(number, value):
    """Encode a field of a message: an integer, or bytes."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value % (1 << 64))
    return _varint(number << 3 | 2) + _varint(len(value)) + value


def _varint(value):
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    return bytes(out)
