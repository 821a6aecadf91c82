"""ONNX files that are not what they say: one line of error, little memory, and no other file is read."""

import os
import tracemalloc

import numpy as np
import pytest

from tests.onnx_writer import FLOAT, INT64, Writer, field
from webapp.errors import InputError
from webapp.files.localize.models import global_descriptor, global_model_problem, network

STRING = 8
OUTSIDE = "its weights are in another file, which is not read"


def _tensor(*, dims, **fields):
    """Return an initializer `w`: `raw` are its bytes, `external` entries of external data."""
    data = b"".join(field(1, side) for side in dims) + field(2, FLOAT) + field(8, b"w")
    if "raw" in fields:
        return data + field(9, fields["raw"])
    entries = fields["external"].items()
    return (
        data
        + b"".join(field(13, field(1, k.encode()) + field(2, v.encode())) for k, v in entries)
        + field(14, 1)
    )


def _using(tensor):
    """Return a global descriptor that multiplies the mean colour by the initializer `w`."""
    g = Writer()
    g.add_initializer(tensor)
    mean = g.node("GlobalAveragePool", g.input("image", 1, 3, 8, 8))
    g.node("MatMul", g.node("Flatten", mean, axis=1), "w", name="vector")
    g.output("vector", 1, 4)
    return g.to_bytes()


def _of_kind(kind):
    g = Writer()
    g.node("Identity", g.input("image", 1, 3, 8, 8, kind=kind), name="vector")
    g.output("vector", 1, "d")
    return g.to_bytes()


MODELS = {
    "weights in this folder": (_using(_tensor(dims=(3, 4), external={"location": "weights.bin"})), OUTSIDE),
    "weights above": (_using(_tensor(dims=(3, 4), external={"location": "../weights.bin"})), OUTSIDE),
    "weights at a path": (
        _using(_tensor(dims=(3, 4), external={"location": "/dev/zero", "length": "48"})),
        OUTSIDE,
    ),
    "weights nowhere": (_using(_tensor(dims=(3, 4), external={"location": "none.bin"})), OUTSIDE),
    "12 GB of 4 bytes": (_using(_tensor(dims=(3, 2**30), raw=b"four")), "not a global descriptor model"),
    "a negative side": (_using(_tensor(dims=(3, -4), raw=bytes(48))), "not a global descriptor model"),
    "whole numbers": (_of_kind(INT64), "not a global descriptor model"),
    "texts": (_of_kind(STRING), "not a global descriptor model"),
    "a zip": (b"PK\x03\x04" + bytes(5000), "not a global descriptor model"),
    "a script": (b"#!/bin/sh\necho\n", "not a global descriptor model"),
    "nothing": (b"", "not a global descriptor model"),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_model_that_is_not_what_it_says_is_one_line(tmp_path, monkeypatch, name):
    folder = tmp_path / "models"
    folder.mkdir()
    for weights in (tmp_path / "weights.bin", folder / "weights.bin"):
        np.ones((3, 4), np.float32).tofile(weights)
    monkeypatch.chdir(folder)  # where onnxruntime would look for them
    data, message = MODELS[name]
    (folder / "global.onnx").write_bytes(data)
    tracemalloc.start()
    found = global_model_problem(folder)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.startswith("global.onnx: ") and message in found, found
    assert "\n" not in found and str(tmp_path) not in found
    assert most < 20e6


def test_the_same_model_with_its_weights_inside_is_used(tmp_path):
    weights = np.arange(12, dtype=np.float32).reshape(3, 4)
    (tmp_path / "global.onnx").write_bytes(_using(_tensor(dims=(3, 4), raw=weights.tobytes())))
    assert global_model_problem(tmp_path) == ""
    assert global_descriptor(tmp_path).describe(np.full((8, 8, 3), 9, np.uint8)).shape == (4,)


def test_a_file_larger_than_any_model_is_not_read(tmp_path):
    for name in ("global.onnx", "disk.onnx"):
        with (tmp_path / name).open("wb") as file:
            os.truncate(file.fileno(), 10_000_000_000)  # sparse
    said = "it has more than 2.1 GB, so it is not an ONNX file"
    assert global_model_problem(tmp_path) == f"global.onnx: {said}"
    with pytest.raises(InputError, match=said):
        network("disk", tmp_path)
