"""The network of XFeat (Potje et al., "XFeat: Accelerated features for lightweight image matching", 2024).

Each published model file is exported for one size of photo. The layers work for any size: only the steps with
a size fixed by the export are replaced by equivalent ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.network import Interface, Network
from webapp.extras import extra

if TYPE_CHECKING:
    from onnx import NodeProto

MULTIPLE = 32
"""Width and height of the input are multiples of this."""

CELL = 8
"""Side of a cell, pixels: the outputs have one value for each cell."""

_DESCRIPTORS = "/block_fusion/block_fusion.2/Conv_output_0"
_LOGITS = "/keypoint_head/keypoint_head.3/Conv_output_0"
_RELIABILITY = "/heatmap_head/heatmap_head.2/Conv_output_0"
_OUTPUTS = {_DESCRIPTORS: 64, _LOGITS: 65, _RELIABILITY: 1}
"""Layers in all published files, with their channels; names of later layers differ between the files."""

_GRAY = "/ReduceMean_output_0"
_CELLS = "/Reshape_1_output_0"
"""The photo, and its pixels by cell: an export cuts the photo into a number of strips that fits its size."""

_ENLARGED = {"/Resize_output_0": 2.0, "/Resize_1_output_0": 4.0}
"""Coarse levels and their upsampling factors; exports state the size instead."""


class Maps(NamedTuple):
    """Output of the network for a photo of w x h cells."""

    descriptors: NDArray[np.float32]  # (64, h, w) float32. Not normalised.
    # (65, h, w) float32. Of a keypoint at each of the 64 pixels of the cell, row by row, and of no keypoint.
    logits: NDArray[np.float32]
    # (h, w) float32. Probability that the descriptor can be matched, 0 to 1.
    reliability: NDArray[np.float32]


class XFeatNetwork:
    """The network with its weights; threads may share it.

    Args:
        model: A published model file, already checked.

    Raises:
        MissingPart: onnxruntime is not installed.
    """

    def __init__(self, model: bytes) -> None:
        interface = Interface("XFeat", ("input",), tuple(_OUTPUTS))
        self._network = Network(_for_any_size(model), interface, file="xfeat")

    def maps(self, image: NDArray[np.float32]) -> Maps:
        """Run the network.

        Args:
            image: (h, w) float32. Zero mean and unit variance; sides are multiples of `MULTIPLE`.
        """
        descriptors, logits, reliability = self._network.run(input=image[None, None])
        return Maps(descriptors[0], logits[0], 1.0 / (1.0 + np.exp(-reliability[0, 0])))


def _for_any_size(model: bytes) -> bytes:
    """Rewrite a published model so that height and width are free, with the outputs in `_OUTPUTS`."""
    with extra("learned"):
        import onnx
    whole = onnx.load_model_from_string(model)
    graph = whole.graph
    layers = {output: node for node in graph.node for output in node.output}
    cells = onnx.helper.make_node("SpaceToDepth", [_GRAY], [_CELLS], blocksize=CELL)
    layers[_CELLS] = cells
    for output, factor in _ENLARGED.items():
        scales = onnx.helper.make_tensor(
            f"{output}.scales", onnx.TensorProto.FLOAT, [4], [1, 1, factor, factor]
        )
        graph.initializer.append(scales)
        source, region, *_ = layers[output].input
        layers[output].input[:] = [source, region, scales.name]
    nodes = _in_order(layers)
    shapes = [("input", 1), *_OUTPUTS.items()]
    declared = [
        onnx.helper.make_tensor_value_info(
            name, onnx.TensorProto.FLOAT, [1, channels, f"{name}.h", f"{name}.w"]
        )
        for name, channels in shapes
    ]
    free = onnx.helper.make_graph(nodes, "xfeat", declared[:1], declared[1:], graph.initializer)
    return bytes(
        onnx.helper.make_model(
            free, opset_imports=whole.opset_import, ir_version=whole.ir_version
        ).SerializeToString()
    )


def _in_order(layers: dict[str, NodeProto]) -> list[NodeProto]:
    """List the layers that the outputs depend on, in topological order."""
    done: dict[str, NodeProto] = {}

    def visit(name: str) -> None:
        if name in layers and name not in done:
            for source in layers[name].input:
                visit(source)
            done[name] = layers[name]

    for output in _OUTPUTS:
        visit(output)
    return list(done.values())
