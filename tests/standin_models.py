"""Models with the inputs and outputs of published ones, but simple computations."""

import hashlib
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tests.onnx_writer import INT64, Writer
from webapp.files.localize.models import MODELS

TABLE = np.random.default_rng(0).normal(size=(64, 128)).astype(np.float32)
"""Descriptors; the row of a pixel is its index in the image modulo 64."""

ANY = ("height", "width")


def brightest(kind, *, size=ANY, count=40, table=TABLE, batch=False):
    """Return ALIKED or DISK whose keypoints are the brightest pixels; `size` is height and width."""
    g = Writer()
    c = g.constant
    image = g.input("image", 1, 3, *size)
    flat = g.node("Reshape", g.node("ReduceMean", image, axes=[0, 1], keepdims=0), c([-1]))
    score, pixel = g.node("TopK", flat, c([count]), outputs=2, axis=0)
    return _points(g, kind, image, (score, pixel), table, batch)


def write_aliked(folder):
    """Put stand-ins of ALIKED and of its matching network into a new folder, and return the folder."""
    folder.mkdir()
    (folder / "aliked.onnx").write_bytes(brightest("aliked"))
    (folder / "aliked_lightglue.onnx").write_bytes(glue())
    return folder


def brighter(kind, *, least=0.5):
    """Return ALIKED or DISK whose keypoints are all pixels above `least`."""
    g = Writer()
    c = g.constant
    image = g.input("image", 1, 3, *ANY)
    flat = g.node("Reshape", g.node("ReduceMean", image, axes=[0, 1], keepdims=0), c([-1]))
    pixel = g.node("Reshape", g.node("NonZero", g.node("Greater", flat, c([least]))), c([-1]))
    return _points(g, kind, image, (g.node("Gather", flat, pixel), pixel), TABLE, False)


def _points(g, kind, image, found, table, batch):
    c, (score, pixel) = g.constant, found
    shape = g.node("Shape", image)
    height, width = g.node("Gather", shape, c([2])), g.node("Gather", shape, c([3]))
    y = g.node("Div", pixel, width)
    x = _rest(g, pixel, width)
    xy = g.node("Concat", g.node("Unsqueeze", x, c([1])), g.node("Unsqueeze", y, c([1])), axis=1)
    described = g.node("Gather", c(table), _rest(g, pixel, c([64])))
    if kind == "aliked":
        last = g.node("Cast", g.node("Sub", g.node("Concat", width, height, axis=0), c([1])), to=1)
        part = g.node("Div", g.node("Cast", xy, to=1), last)
        xy = g.node("Sub", g.node("Mul", part, c([2.0])), c([1.0]))
    one = (1,) if kind != "aliked" or batch else ()
    for name, values, sides in (
        ("keypoints", xy, ("n", 2)),
        ("scores", score, ("n",)),
        ("descriptors", described, ("n", table.shape[1])),
    ):
        if one:
            g.node("Unsqueeze", values, c([0]), name=name)
        else:
            g.node("Identity", values, name=name)
        g.output(name, *one, *sides, kind=INT64 if kind != "aliked" and name == "keypoints" else 1)
    return g.to_bytes()


def _rest(g, number, by):
    return g.node("Sub", number, g.node("Mul", g.node("Div", number, by), by))


def glue(names=("matches0", "mscores0"), *, width=128, by="place"):
    """Return LightGlue that matches each query keypoint to the nearest or most similar one in the photo.

    By place, the score falls to 0 at half a photo's side. By look, similarities come from an Einsum that is a
    matrix product; by odd look, from another one.
    """
    g = Writer()
    c = g.constant
    like = _likeness(g, width, by)
    best = g.node("Reshape", g.node("ReduceMax", like, axes=[2], keepdims=0), c([-1]))
    other = g.node("Reshape", g.node("ArgMax", like, axis=2, keepdims=0), c([-1, 1]))
    every = g.node("Add", g.node("Mul", best, c([0.0])), c([1.0]))
    row = g.node("Transpose", g.node("NonZero", g.node("Greater", every, c([0.0]))), perm=[1, 0])
    g.node("Concat", row, other, axis=1, name=names[0])
    g.node("Identity", best, name=names[1])
    g.output(names[0], "k", 2, kind=INT64)
    g.output(names[1], "k")
    return g.to_bytes()


def lighter_glue(**more):
    """Return LighterGlue: like `glue`, with other names."""
    return glue(("matches", "scores"), **more)


def _likeness(g, width, by):
    """Compare all keypoints: (1, n, m)."""
    c = g.constant
    here, there = g.input("kpts0", 1, "n", 2), g.input("kpts1", 1, "m", 2)
    seen, shown = g.input("desc0", 1, "n", width), g.input("desc1", 1, "m", width)
    if by == "place":
        apart = g.node("Sub", g.node("Unsqueeze", here, c([2])), g.node("Unsqueeze", there, c([1])))
        square = g.node("ReduceSum", g.node("Mul", apart, apart), c([3]), keepdims=0)
        return g.node("Sub", c([1.0]), g.node("Sqrt", square))
    if by == "odd look":
        return g.node("Einsum", shown, seen, equation="bmd,bnd->bnm")
    return g.node("Einsum", seen, shown, equation="bnd,bmd->bnm")


def passed_on(width="width", height="height", *, outputs=("all",), scale=1.0):
    """Return a global descriptor that is the image itself times `scale`."""
    g = Writer()
    flat = g.node("Flatten", g.input("image", 1, 3, height, width), axis=1)
    vector = g.node("Mul", flat, g.constant([scale]))
    for name in outputs:
        g.node("Identity", vector, name=name)
        g.output(name, 1, "d")
    return g.to_bytes()


def tiny_image(width=64, height=48, *, columns=16, rows=12, metadata=()):
    """Return a global descriptor: the photo scaled down to a few pixels, minus its mean brightness."""
    g = Writer()
    fixed = isinstance(width, int)
    side = [height // rows, width // columns] if fixed else [4, 4]
    image = g.input("image", 1, 3, height, width)
    small = g.node("AveragePool", image, kernel_shape=side, strides=side)
    flat = g.node("Flatten", small, axis=1)
    g.node("Sub", flat, g.node("ReduceMean", flat, axes=[1], keepdims=1), name="vector")
    g.output("vector", 1, 3 * columns * rows if fixed else "d")
    for key, value in metadata:
        g.metadata(key, value)
    return g.to_bytes()


CHANNELS = {
    "block1": (1, 4, 8, 8, 24),
    "block2": (24, 24, 24),
    "block3": (24, 64, 64, 64),
    "block4": (64, 64, 64, 64),
    "block5": (64, 128, 128, 128, 64),
    "block_fusion": (64, 64, 64, 64),
    "heatmap_head": (64, 64, 64, 1),
    "keypoint_head": (64, 64, 64, 64, 65),
}
ONE_BY_ONE = {"block3.2", "block5.3", "block_fusion.2"}
HALVING = {"block1.1", "block1.3", "block3.0", "block4.0", "block5.0"}


def xfeat(height=96, width=128):
    """Return XFeat for one size, as published, with random weights."""
    g, rng = Writer(), np.random.default_rng(1)
    c = g.constant
    gray = g.node("ReduceMean", g.input("input", 1, 1, height, width), name="/ReduceMean_output_0", axes=[1])

    def convolution(layer, source, *, side, channels, stride=1):
        weight = rng.normal(size=(*channels[::-1], side, side)) * (2.0 / (channels[0] * side**2)) ** 0.5
        weight *= 3.0 if layer == "keypoint_head.3" else 1.0
        name = f"/{layer.partition('.')[0]}/{layer}/Conv_output_0"
        shape = {"kernel_shape": [side] * 2, "strides": [stride] * 2, "pads": [side // 2] * 4}
        return g.node("Conv", source, c(weight), c(np.zeros(channels[1])), name=name, **shape)

    def block(name, source):
        widths = [*pairwise(CHANNELS[name])]
        for i, channels in enumerate(widths):
            layer = f"{name}.{i}"
            side = 1 if layer in ONE_BY_ONE or name.endswith("head") else 3
            stride = 2 if layer in HALVING else 1
            source = convolution(layer, source, side=side, channels=channels, stride=stride)
            if i < len(widths) - 1 or (name.startswith("block") and name != "block_fusion"):
                source = g.node("Relu", source)
        return source

    def enlarged(source, name):
        sizes = c([1, 64, height // 8, width // 8])
        how = {"coordinate_transformation_mode": "half_pixel", "mode": "linear"}
        return g.node("Resize", source, c(np.zeros(0)), c(np.zeros(0)), sizes, name=name, **how)

    quarter = g.node("AveragePool", gray, kernel_shape=[4, 4], strides=[4, 4])
    skip = convolution("skip1.1", quarter, side=1, channels=(1, 24))
    eighth = block("block3", block("block2", g.node("Add", block("block1", gray), skip)))
    sixteenth = block("block4", eighth)
    coarse = enlarged(sixteenth, "/Resize_output_0")
    coarsest = enlarged(block("block5", sixteenth), "/Resize_1_output_0")
    features = block("block_fusion", g.node("Add", g.node("Add", eighth, coarse), coarsest))
    reliability = g.node("Sigmoid", block("heatmap_head", features), name="reliability")
    pixels = g.node("Reshape", gray, c([1, height // 8, 8, width // 8, 8]))
    pixels = g.node("Transpose", pixels, perm=[0, 2, 4, 1, 3])
    cells = g.node("Reshape", pixels, c([1, 64, height // 8, width // 8]), name="/Reshape_1_output_0")
    logits = block("keypoint_head", cells)
    for name, source, channels in (("output_feats", features, 64), ("output_heatmap", logits, 65)):
        g.node("Transpose", source, name=name, perm=[0, 2, 3, 1])
        g.output(name, 1, height // 8, width // 8, channels)
    g.output(reliability, 1, 1, height // 8, width // 8)
    return g.to_bytes()


def lpd_yunet():
    """Return LPD-YuNet that detects white as plates: 16 pixels around each cell of 8, scored by it."""
    g = Writer()
    c = g.constant
    grey = g.node("ReduceMean", g.input("input", 1, 3, 240, 320), axes=[1], keepdims=1)
    cells = g.node("AveragePool", grey, kernel_shape=[8, 8], strides=[8, 8])
    white = g.node("Mul", g.node("Reshape", cells, c([1200, 1])), c([1 / 255]))
    smallest = g.node("Reshape", g.node("MatMul", white, c([[1.0, 0.0, 0.0]])), c([3600, 1]))
    sure = g.node("Concat", smallest, c(np.zeros((785, 1))), axis=0)
    corners = np.zeros((1, 14))
    corners[0, [4, 5, 7, 12]], corners[0, [6, 10, 11, 13]] = -8, 8
    g.node("Add", g.node("MatMul", sure, c(np.zeros((1, 14)))), c(corners), name="loc")
    g.node("MatMul", sure, c([[0.0, 1.0]]), name="conf")
    g.node("Add", g.node("Mul", sure, c([0.0])), c([1.0]), name="iou")
    for name, width in (("loc", 14), ("conf", 2), ("iou", 1)):
        g.output(name, 4385, width)
    return g.to_bytes()


def yunet():
    """Return YuNet that detects white as faces: 16 pixels around each cell of 8, scored by brightness."""
    g = Writer()
    c = g.constant
    grey = g.node("ReduceMean", g.input("input", 1, 3, 640, 640), axes=[1], keepdims=1)
    for stride in (8, 16, 32):
        count = (640 // stride) ** 2
        cells = g.node("AveragePool", grey, kernel_shape=[stride] * 2, strides=[stride] * 2)
        share = 1 / 255 if stride == 8 else 0.0
        white = g.node("Mul", g.node("Reshape", cells, c([1, count, 1])), c([share]))
        none = g.node("Mul", white, c([0.0]))
        g.node("Add", white, c([0.0]), name=f"cls_{stride}")
        g.node("Add", none, c([1.0]), name=f"obj_{stride}")
        half = np.array([[[0.5, 0.5, np.log(2), np.log(2)]]])
        g.node("Add", g.node("MatMul", none, c(np.zeros((1, 1, 4)))), c(half), name=f"bbox_{stride}")
        g.node("MatMul", none, c(np.zeros((1, 1, 10))), name=f"kps_{stride}")
        for name, width in (("cls", 1), ("obj", 1), ("bbox", 4), ("kps", 10)):
            g.output(f"{name}_{stride}", 1, count, width)
    return g.to_bytes()


def install_blur_networks(folder, patch, *, models=("faces", "plates")):
    """Put stand-ins of the networks for faces and plates into a folder, as if they were the published ones.

    `patch` sets an item of a mapping: `monkeypatch.setitem`, or `operator.setitem` in a separate process.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for model in models:
        data = {"faces": yunet, "plates": lpd_yunet}[model]()
        file = replace(MODELS[model][0], bytes=len(data), sha256=hashlib.sha256(data).hexdigest())
        (folder / file.name).write_bytes(data)
        patch(MODELS, model, (file,))
    return folder
