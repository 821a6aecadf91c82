"""Models with the inputs and outputs of ALIKED, DISK and LightGlue, that compute something simple."""

import numpy as np

from tests.onnx_writer import INT64, Writer
from webapp.core.features.lightglue import BEST

TABLE = np.random.default_rng(0).normal(size=(64, 128)).astype(np.float32)
"""Descriptors: of a pixel, the row is its number in the image, modulo 64."""

ANY = ("height", "width")


def brightest(kind, *, size=ANY, count=40, table=TABLE, batch=False):
    """ALIKED or DISK whose keypoints are the brightest pixels; `size` is height and width."""
    g = Writer()
    c = g.constant
    image = g.input("image", 1, 3, *size)
    flat = g.node("Reshape", g.node("ReduceMean", image, axes=[0, 1], keepdims=0), c([-1]))
    score, pixel = g.node("TopK", flat, c([count]), outputs=2, axis=0)
    return _points(g, kind, image, (score, pixel), table, batch)


def brighter(kind, *, least=0.5):
    """ALIKED or DISK whose keypoints are all pixels above `least`."""
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
    one = (1,) if kind == "disk" or batch else ()
    for name, values, sides in (
        ("keypoints", xy, ("n", 2)),
        ("scores", score, ("n",)),
        ("descriptors", described, ("n", table.shape[1])),
    ):
        if one:
            g.node("Unsqueeze", values, c([0]), name=name)
        else:
            g.node("Identity", values, name=name)
        g.output(name, *one, *sides, kind=INT64 if kind == "disk" and name == "keypoints" else 1)
    return g.to_bytes()


def _rest(g, number, by):
    return g.node("Sub", number, g.node("Mul", g.node("Div", number, by), by))


def glue(names=("matches0", "mscores0"), *, width=128, by="place"):
    """LightGlue: for each query keypoint the one in the photo that is nearest in place, or most alike.

    By place, the score falls to 0 half a photo away. The most alike are found by an Einsum: by look, by one
    that is a product of matrices; by odd look, by another.
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


def lighter_glue(*, width=64, by="place"):
    """LighterGlue: as `glue`, with the layers that its matches are made of."""
    g = Writer()
    like = _likeness(g, width, by)
    likely, partner, back = BEST
    best = g.node("Max", g.node("ReduceMax", like, axes=[2], keepdims=1), g.constant([1e-9]))
    g.node("Log", best, name=likely)
    g.node("ArgMax", like, axis=2, keepdims=1, name=partner)
    g.node("ArgMax", like, axis=1, keepdims=1, name=back)
    g.node("NonZero", best, name="matches")
    g.output("matches", 3, "k", kind=INT64)
    return g.to_bytes()


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
