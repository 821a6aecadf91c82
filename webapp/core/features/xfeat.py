"""XFeat: learned keypoints and descriptors that also match between day and night.

Potje et al., "XFeat: Accelerated features for lightweight image matching", 2024. Each published model file is
exported for one size of photo. The layers work for any size: only the steps with a size fixed by the export
are replaced by equivalent ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.network import Interface, Network
from webapp.extras import extra

if TYPE_CHECKING:
    from onnx import NodeProto

from collections.abc import Sequence

import cv2

from webapp.core.features.entry import FeatureEntry, ModelEntry, ModelFile
from webapp.core.features.lightglue import LIGHTERGLUE, LightGlue
from webapp.core.features.types import LEAST_CONTRAST, ONE_SIZE, Described, Kind, unit_as_bytes
from webapp.errors import MissingPart

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
    """The network with its weights; threads may share it."""

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


_MIN_PROBABILITY = 0.05
"""Minimum probability of a keypoint at its pixel."""

_NMS_WINDOW = np.ones((5, 5), np.uint8)
"""Window of the non-maximum suppression."""


class XFeat:
    """Detector and extractor. Its keypoints have one scale and no orientation.

    Args:
        network: Required for detection and description.
    """

    kind: Kind = "float"
    width = 64
    oriented = False

    def __init__(self, network: XFeatNetwork | None = None) -> None:
        self._network = network

    def detect(self, gray: NDArray[np.uint8], keypoints: int) -> Sequence[cv2.KeyPoint]:
        """Detect the `keypoints` best keypoints of an (h, w) uint8 image."""
        maps = self._maps(gray)
        return () if maps is None else _as_keypoints(*_peaks(maps, gray.shape, keypoints))

    def detect_and_describe(self, gray: NDArray[np.uint8], keypoints: int) -> Described:
        """Detect and describe the `keypoints` best keypoints; descriptors (n, 64) uint8."""
        maps = self._maps(gray)
        if maps is None:
            return (), np.zeros((0, self.width), np.uint8)
        xy, score = _peaks(maps, gray.shape, keypoints)
        return _as_keypoints(xy, score), _descriptors(maps, xy)

    def describe(self, gray: NDArray[np.uint8], keypoints: Sequence[cv2.KeyPoint]) -> Described:
        """Describe another detector's keypoints; descriptors (n, 64) uint8."""
        maps = self._maps(gray) if keypoints else None
        if maps is None:
            return (), np.zeros((0, self.width), np.uint8)
        return keypoints, _descriptors(maps, np.array([k.pt for k in keypoints], np.float32))

    def _maps(self, gray: NDArray[np.uint8]) -> Maps | None:
        """Run the network on a photo; None if it has no texture."""
        if self._network is None:
            raise MissingPart("the weights of XFeat are not installed", hint="run expmap models fetch")
        mean, contrast = (float(v.item()) for v in cv2.meanStdDev(gray))
        if contrast < LEAST_CONTRAST:
            return None
        height, width = gray.shape
        # repeat the last pixels, to avoid an edge at the photo's border
        whole = cv2.copyMakeBorder(gray, 0, -height % MULTIPLE, 0, -width % MULTIPLE, cv2.BORDER_REPLICATE)
        return self._network.maps((whole.astype(np.float32) - np.float32(mean)) / np.float32(contrast))


def _peaks(
    maps: Maps, shape: tuple[int, int], keypoints: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Extract the keypoints of a photo of `shape`: (n, 2) pixels and (n,) scores, the best first."""
    heat = _heat(maps.logits)
    maximum = (heat == cv2.dilate(heat, _NMS_WINDOW)) & (heat > _MIN_PROBABILITY)
    y, x = np.nonzero(maximum[: shape[0], : shape[1]])
    pixel = np.column_stack([x, y]).astype(np.float32)
    score = heat[y, x] * _sampled(maps.reliability, pixel, cv2.INTER_LINEAR)
    best = np.argsort(-score, kind="stable")[:keypoints]
    return pixel[best] + _subpixel_offset(heat, x[best], y[best]), score[best]


def _heat(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert (65, h, w) logits to the probability of a keypoint at each pixel, (8 h, 8 w)."""
    likely = np.exp(logits - logits.max(axis=0))
    likely = likely[:-1] / likely.sum(axis=0)
    height, width = likely.shape[1:]
    pixels = likely.reshape(CELL, CELL, height, width).transpose(2, 0, 3, 1)
    return np.ascontiguousarray(pixels).reshape(CELL * height, CELL * width)


def _subpixel_offset(
    heat: NDArray[np.float32], x: NDArray[np.int64], y: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Refine peaks to sub-pixels: offset of the centroid of the 3 x 3 pixels around each, (n, 2).

    Measured by known homographies it is more accurate than the vertex of a parabola.
    """
    padded = np.pad(heat, 1)
    around = np.stack([padded[y + row, x + column] for row in range(3) for column in range(3)], axis=1)
    step = np.array([[c - 1, r - 1] for r in range(3) for c in range(3)], np.float32)
    offset: NDArray[np.float32] = around @ step / around.sum(axis=1, keepdims=True)
    return offset


def _descriptors(maps: Maps, xy: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Interpolate the map of descriptors at (n, 2) pixels, as (n, 64) uint8."""
    length = np.sqrt(np.square(maps.descriptors).sum(axis=0))
    units = maps.descriptors / np.maximum(length, np.float32(1e-9))
    values = np.stack([_sampled(channel, xy, cv2.INTER_CUBIC) for channel in units], axis=1)
    values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), np.float32(1e-9))
    return unit_as_bytes(values)


def _sampled(cells: NDArray[np.float32], xy: NDArray[np.float32], how: int) -> NDArray[np.float32]:
    """Interpolate (h, w) values of cells at (n, 2) pixels, as (n,)."""
    if not len(xy):
        return np.zeros(0, np.float32)
    # The position of a cell's value is its centre, 3.5 pixels from its first pixel.
    at = ((xy + 0.5) / CELL - 0.5)[None]
    x, y = np.ascontiguousarray(at[:, :, 0]), np.ascontiguousarray(at[:, :, 1])
    found: NDArray[np.float32] = cv2.remap(cells, x, y, how, borderMode=cv2.BORDER_REPLICATE)[0]
    return found


def _as_keypoints(xy: NDArray[np.float32], score: NDArray[np.float32]) -> list[cv2.KeyPoint]:
    return [
        cv2.KeyPoint(x, y, ONE_SIZE, 0.0, s) for (x, y), s in zip(xy.tolist(), score.tolist(), strict=True)
    ]


_SOURCE = "XFeat of github.com/verlab/accelerated_features, as exported in github.com/meyiao/xfeatc"

_XFEAT = ModelEntry(
    "xfeat",
    (
        ModelFile(
            name="xfeat_800x576.onnx",
            bytes=4_106_753,
            sha256="26c77ad51d6bdbc4b9d172344a1d84e9bb6dddf6e5704815bfb21c39a586c270",
            licence="Apache-2.0",
            source=_SOURCE,
            address="https://raw.githubusercontent.com/meyiao/xfeatc/"
            "230ee93c5a8514216dcdc8c64f9de606b681dfb2/model/xfeat_800x576.onnx",
        ),
        ModelFile(
            name="xfeat_640x640.onnx",
            bytes=4_016_395,
            sha256="55a50801d21564c3cf5e3afe1d360dbbe8390ab3ca2c167f08d4d476504ac473",
            licence="Apache-2.0",
            source=_SOURCE,
            address="https://raw.githubusercontent.com/meyiao/xfeatc/"
            "230ee93c5a8514216dcdc8c64f9de606b681dfb2/model/xfeat_640x640.onnx",
        ),
    ),
    lambda model, _file: XFeatNetwork(model),
)

_LIGHTERGLUE = ModelEntry(
    "lighterglue",
    (
        ModelFile(
            name="lighterglue_L3.onnx",
            bytes=2_349_183,
            sha256="a721f366f54b20328fa98c799cc31478edb1c31f0c941528df3d363c3753760d",
            licence="Apache-2.0",
            source="LighterGlue of github.com/verlab/accelerated_features, exported with 3 layers by the "
            "program of github.com/noahzhy/xfeat_lightglue_onnx",
            address="https://raw.githubusercontent.com/noahzhy/xfeat_lightglue_onnx/"
            "155f5e1b6c9453162c286eacb0003fa4b8461a9c/onnx/lighterglue_L3.onnx",
        ),
    ),
    lambda model, file: LightGlue(model, LIGHTERGLUE, file=file),
)

ENTRIES = (FeatureEntry("xfeat", XFeat, model=_XFEAT, pair_matcher=_LIGHTERGLUE, enlarges_small=True),)
