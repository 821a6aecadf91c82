"""The network of XFeat (Potje et al. 2024), for photos of any size.

The published model files are made for one size of photo each. Their weights fit any: here they are put into a
network of the same layers that takes every size, with its first steps done on the photo directly, where
OpenCV is several times as fast. What comes out is the same.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.onnx import Convolution, Graph, read_convolutions
from webapp.threads import Pool

MULTIPLE = 32
"""Width and height of what goes through the network are multiples of this."""

LEAST_SIDE = 64
"""With less, OpenCV's convolutions of the coarsest level, one value wide, read memory that nobody wrote."""

CELL = 8
"""Pixels of a cell: the outputs have one value for each."""

_STRIDES = {
    "block1": (1, 2, 1, 2),
    "block2": (1, 1),
    "block3": (2, 1, 1),
    "block4": (2, 1, 1),
    "block5": (2, 1, 1, 1),
    "block_fusion": (1, 1, 1),
    "heatmap_head": (1, 1, 1),
    "keypoint_head": (1, 1, 1, 1),
}
_HEADS = ("block_fusion", "heatmap_head", "keypoint_head")
"""Their last convolution is not rectified."""

_INPUTS = ("edges", "quarter", "cells")
_OUTPUTS = (("block_fusion.2", 64), ("keypoint_head.3", 65), ("reliability", 1))


class Maps(NamedTuple):
    """What the network says about a photo of w x h cells.

    Attributes
    ----------
    descriptors : (64, h, w) float32
        Not normalised.
    logits : (65, h, w) float32
        Of a keypoint at each of the 64 pixels of the cell, row by row, and of none.
    reliability : (h, w) float32
        How well what is seen can be matched, 0 to 1.
    """

    descriptors: NDArray[np.float32]
    logits: NDArray[np.float32]
    reliability: NDArray[np.float32]


class XFeatNetwork:
    """The network with its weights; may be used by several threads.

    Parameters
    ----------
    model : bytes
        A published model file, known to be whole.
    """

    def __init__(self, model: bytes) -> None:
        layers = {_short(name): layer for name, layer in read_convolutions(model).items()}
        self._first = layers["block1.0"]
        onnx = np.frombuffer(_any_size(layers), np.uint8)
        self._nets = Pool(lambda: cv2.dnn.readNetFromONNX(onnx))

    def maps(self, image: NDArray[np.float32]) -> Maps:
        """Run the network.

        Parameters
        ----------
        image : (h, w) float32
            Zero mean and unit variance; sides are multiples of `MULTIPLE`, at least `LEAST_SIDE`.

        Returns
        -------
        Maps
        """
        blobs = self._blobs(image)
        with self._nets.lent() as net:
            for name, blob in zip(_INPUTS, blobs, strict=True):
                net.setInput(blob, name)
            descriptors, logits, reliability = net.forward([name for name, _ in _OUTPUTS])
        return Maps(descriptors[0], logits[0], reliability[0, 0])

    def _blobs(self, image: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        height, width = image.shape
        weight, bias = self._first
        edges = np.empty((1, len(weight), height, width), np.float32)
        for out, kernel, shift in zip(edges[0], weight[:, 0], bias, strict=True):
            cv2.filter2D(image, -1, kernel, dst=out, delta=float(shift), borderType=cv2.BORDER_CONSTANT)
        np.maximum(edges, 0.0, out=edges)
        quarter = cv2.resize(image, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
        cells = image.reshape(height // CELL, CELL, width // CELL, CELL).transpose(1, 3, 0, 2)
        flat = np.ascontiguousarray(cells).reshape(1, CELL * CELL, height // CELL, width // CELL)
        return [edges, quarter[None, None], flat]


def _short(output: str) -> str:
    """Shorten a layer's name: "/block1/block1.0/layer/layer.0/Conv_output_0" is "block1.0"."""
    return output.split("/")[2]


def _any_size(layers: dict[str, Convolution]) -> bytes:
    graph = Graph()
    edges, quarter, cells = (graph.input(n, c) for n, c in zip(_INPUTS, (4, 1, 64), strict=True))

    def block(name: str, source: str, first: int = 0) -> str:
        strides = _STRIDES[name]
        for i in range(first, len(strides)):
            layer, relu = f"{name}.{i}", name not in _HEADS or i < len(strides) - 1
            source = graph.convolution(layer, source, of=layers[layer], stride=strides[i], relu=relu)
        return source

    skip = graph.convolution("skip1.1", quarter, of=layers["skip1.1"], relu=False)
    half = block("block2", graph.sum("stem", of=(block("block1", edges, first=1), skip)))
    eighth = block("block3", half)
    sixteenth = block("block4", eighth)
    coarse = graph.enlarge("from4", sixteenth, times=2)
    coarsest = graph.enlarge("from5", block("block5", sixteenth), times=4)
    features = block("block_fusion", graph.sum("all", of=(graph.sum("fine", of=(eighth, coarse)), coarsest)))
    graph.sigmoid("reliability", block("heatmap_head", features))
    block("keypoint_head", cells)
    return graph.to_bytes(_OUTPUTS)
