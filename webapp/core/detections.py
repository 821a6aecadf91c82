"""Detection of faces and number plates, also small ones, which may have to be blurred in photos.

A network takes images of one size. A photo is cut into overlapping windows of that size, first at full size,
then halved repeatedly until one window contains all of it (an image pyramid): small objects are found at full
size, and large ones in a halved photo.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Literal, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.boxes import BlurBox

Kind = Literal["face", "plate"]

_SAME = 0.6
"""Two boxes of one kind show the same object if they share more than this part of the smaller one."""

_HIDDEN = 0.6
"""An object is hidden if at least this share of its box is blurred."""

_STEPS = (np.arange(12) + 0.5) / 12
"""Positions, along each side of a box, at which it is sampled."""

_MARGIN: dict[Kind, float] = {"face": 0.2, "plate": 0.1}
"""Margin on each side, as a share of a box's size: hair and chin identify a face, too."""


class Detection(NamedTuple):
    """A face or a number plate."""

    kind: Kind
    box: BlurBox  # Without margin
    score: float  # Confidence of the network, 0 to 1; not calibrated


def never() -> None:
    """Do nothing, so that a detection is never stopped."""


class ObjectDetector(Protocol):
    def detect(self, pixels: NDArray[np.uint8], *, check: Callable[[], None] = never) -> list[Detection]:
        """Find them in a photo of (h, w, 3) uint8, blue, green, red; the highest score first.

        `check` is called between windows, and raises to stop.
        """


class Window(NamedTuple):
    """A window in a photo that was halved `level` times; its corner in pixels of that level."""

    level: int
    left: int
    top: int


class WindowDetections(NamedTuple):
    """Boxes in a window: (n, 4) left, top, right, bottom in its pixels, and (n,) scores."""

    boxes: NDArray[np.float64]
    scores: NDArray[np.float64]


def spans(length: int, *, size: int, overlap: int) -> list[int]:
    """Return the starts of evenly spread, overlapping windows that cover a side."""
    if length <= size:
        return [0]
    count = 1 + -(-(length - size) // (size - overlap))
    return [round(n * (length - size) / (count - 1)) for n in range(count)]


def windows(
    pixels: NDArray[np.uint8], *, size: tuple[int, int], overlap: int
) -> Iterator[tuple[Window, NDArray[np.uint8]]]:
    """Cut a photo into windows of `size`, width and height; beyond its edges they are black."""
    level = 0
    while True:
        height, width = pixels.shape[:2]
        for top in spans(height, size=size[1], overlap=overlap):
            for left in spans(width, size=size[0], overlap=overlap):
                part = np.zeros((size[1], size[0], 3), np.uint8)
                cut = pixels[top : top + size[1], left : left + size[0]]
                part[: cut.shape[0], : cut.shape[1]] = cut
                yield Window(level, left, top), part
        if width <= size[0] and height <= size[1]:
            return
        halved = (max(1, (width + 1) // 2), max(1, (height + 1) // 2))
        pixels = np.asarray(cv2.resize(pixels, halved, interpolation=cv2.INTER_AREA), np.uint8)
        level += 1


def detect_in_windows(
    pixels: NDArray[np.uint8],
    detect: Callable[[NDArray[np.uint8]], WindowDetections],
    *,
    kind: Kind,
    size: tuple[int, int],
    overlap: int,
    check: Callable[[], None] = never,
) -> list[Detection]:
    """Find objects in a photo of any size with a network for images of one size.

    Args:
        pixels: (h, w, 3) uint8
        detect: Runs the network on a window.
        overlap: Pixels; an object that is not larger is completely inside one of the windows of a level.
        check: Called before each window; raises to stop.

    Returns:
        Each object once, the highest score first.
    """
    height, width = pixels.shape[:2]
    whole = np.array([width, height, width, height], np.float64)
    found: list[Detection] = []
    for window, part in windows(pixels, size=size, overlap=overlap):
        check()
        boxes, scores = detect(part)
        corner = np.array([window.left, window.top] * 2, np.float64)
        shares = np.clip((boxes + corner) * 2**window.level / whole, 0, 1)
        for (left, top, right, bottom), score in zip(shares.tolist(), scores.tolist(), strict=True):
            if right > left and bottom > top:
                found.append(Detection(kind, BlurBox(left, top, right - left, bottom - top), score))
    return merge_duplicates(found)


def merge_duplicates(found: Iterable[Detection]) -> list[Detection]:
    """Join detections of the same object by several windows: a box around all, with the highest score."""
    joined: list[Detection] = []
    for one in sorted(found, key=lambda one: -one.score):
        n = next((n for n, known in enumerate(joined) if _is_same(known, one)), None)
        if n is None:
            joined.append(one)
        else:
            joined[n] = joined[n]._replace(box=_around(joined[n].box, one.box))
    return joined


def non_maximum_suppression(
    boxes: NDArray[np.float64], scores: NDArray[np.float64], *, overlap: float
) -> list[int]:
    """Select boxes by non-maximum suppression, so that no two overlap by more than `overlap`.

    Args:
        boxes: (n, 4) float64. Left, top, right, bottom.
        scores: (n,) float64
        overlap: Intersection over union.

    Returns:
        Numbers of the boxes, the highest score first.
    """
    left = np.argsort(-scores, kind="stable")
    areas = (boxes[:, 2] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 1])
    chosen: list[int] = []
    while left.size:
        best, others = int(left[0]), left[1:]
        chosen.append(best)
        low = np.maximum(boxes[best, :2], boxes[others, :2])
        high = np.minimum(boxes[best, 2:], boxes[others, 2:])
        shared = np.prod(np.clip(high - low, 0, None), axis=1)
        left = others[shared <= overlap * (areas[best] + areas[others] - shared)]
    return chosen


def boxes_to_blur(found: Iterable[Detection], *, blurred: Iterable[BlurBox]) -> list[Detection]:
    """Add a margin to the boxes of detections, and leave out what is already blurred."""
    there = list(blurred)
    wide = ((one, one._replace(box=_with_margin(one))) for one in found)
    return [wider for one, wider in wide if wider.box.inside and not is_hidden(one.box, there)]


def _with_margin(one: Detection) -> BlurBox:
    box, margin = one.box, _MARGIN[one.kind]
    left, right = (np.clip(box.x + share * box.width, 0, 1) for share in (-margin, 1 + margin))
    top, bottom = (np.clip(box.y + share * box.height, 0, 1) for share in (-margin, 1 + margin))
    return BlurBox(float(left), float(top), float(right - left), float(bottom - top))


def is_hidden(box: BlurBox, blurred: Sequence[BlurBox]) -> bool:
    """Return whether most of a box is blurred already, by one or more boxes."""
    if not blurred:
        return False
    x, y = box.x + box.width * _STEPS, box.y + box.height * _STEPS[:, None]
    covered = np.zeros((_STEPS.size, _STEPS.size), bool)
    for b in blurred:
        covered |= (b.x <= x) & (x <= b.x + b.width) & (b.y <= y) & (y <= b.y + b.height)
    return bool(covered.mean() >= _HIDDEN)


def _is_same(one: Detection, other: Detection) -> bool:
    a, b = one.box, other.box
    width = min(a.x + a.width, b.x + b.width) - max(a.x, b.x)
    height = min(a.y + a.height, b.y + b.height) - max(a.y, b.y)
    if one.kind != other.kind or min(width, height) <= 0:
        return False
    return width * height > _SAME * min(a.width * a.height, b.width * b.height)


def _around(a: BlurBox, b: BlurBox) -> BlurBox:
    x, y = min(a.x, b.x), min(a.y, b.y)
    return BlurBox(x, y, max(a.x + a.width, b.x + b.width) - x, max(a.y + a.height, b.y + b.height) - y)


_FACE_SIZE = (640, 640)
"""Input size of the published model; it finds faces of about 10 to 300 pixels."""

_FACE_OVERLAP_PX = 128
_FACE_LEAST_SCORE = 0.6
_FACE_OVERLAP = 0.3
"""Of two faces that overlap by more, only the better one is kept."""

_MOST_FACES = 200


class YuNet:
    def __init__(self, model: bytes) -> None:
        self._model = np.frombuffer(model, np.uint8)

    def detect(self, pixels: NDArray[np.uint8], *, check: Callable[[], None] = never) -> list[Detection]:
        # not shared: a network of OpenCV serves one thread at a time; this one loads in milliseconds
        network = cv2.FaceDetectorYN.create(
            "onnx",
            self._model,
            np.zeros(0, np.uint8),
            _FACE_SIZE,
            _FACE_LEAST_SCORE,
            _FACE_OVERLAP,
            _MOST_FACES,
        )

        def detect(part: NDArray[np.uint8]) -> WindowDetections:
            found = network.detect(part)[1]
            rows = np.zeros((0, 15)) if found is None else np.asarray(found, np.float64)
            return WindowDetections(np.hstack([rows[:, :2], rows[:, :2] + rows[:, 2:4]]), rows[:, 14])

        return detect_in_windows(
            pixels, detect, kind="face", size=_FACE_SIZE, overlap=_FACE_OVERLAP_PX, check=check
        )


PLATE_SIZE = (320, 240)
"""Width and height of the images that the published file takes."""

_LAYERS = ((8, (10, 16, 24)), (16, (32, 48)), (32, (64, 96)), (64, (128, 192, 256)))
"""Stride of each layer, and the sizes of its plate_priors, in pixels."""

_VARIANCE = 0.1
"""Unit of corner offsets, over a prior's size; the other variance, 0.2, is of widths, which are not used."""

_CORNERS = (4, 6, 10, 12)
"""Columns of the corners' x; 0 to 3 are a box, and 8 and 9 its centre."""

_OUTPUTS = ("loc", "conf", "iou")
_PLATE_LEAST_SCORE = 0.6
_PLATE_OVERLAP = 0.3
"""Of two plates that overlap by more, only the better one is kept."""

_PLATE_OVERLAP_PX = 96


def plate_priors(width: int, height: int) -> NDArray[np.float64]:
    """List the prior boxes that a network for images of this size refines.

    Returns:
        (n, 3) float64: Centre and side in pixels; by layer, row, column and size.
    """
    shape = np.array([(height + 1) // 2 // 2, (width + 1) // 2 // 2])
    found = []
    for stride, sides in _LAYERS:
        shape = shape // 2
        rows, columns = shape.tolist()
        y, x, side = np.meshgrid(np.arange(rows), np.arange(columns), np.array(sides), indexing="ij")
        found.append(np.stack([(x + 0.5) * stride, (y + 0.5) * stride, side], axis=-1).reshape(-1, 3))
    return np.concatenate(found).astype(np.float64)


def decode_plates(outputs: Sequence[NDArray[np.float32]], at: NDArray[np.float64]) -> WindowDetections:
    """Convert the network's outputs to boxes around the corners of plates.

    Args:
        outputs: sequence of (n, 14), (n, 2) and (n, 1) float32. `loc`, `conf`, `iou`: for each prior,
            position of the plate, score of there being one and of its box.
        at: (n, 3) float64. As from `plate_priors`.

    Returns:
        Those above the minimum score, each plate once, the best first.
    """
    loc, conf, iou = outputs
    scores = np.sqrt(conf[:, 1].astype(np.float64) * np.clip(iou[:, 0].astype(np.float64), 0, 1))
    sure = np.flatnonzero(scores >= _PLATE_LEAST_SCORE)
    x, y = (
        at[sure, axis, None] + loc[sure][:, [c + axis for c in _CORNERS]] * _VARIANCE * at[sure, 2:3]
        for axis in (0, 1)
    )
    boxes = np.stack([x.min(1), y.min(1), x.max(1), y.max(1)], axis=1).astype(np.float64)
    best = non_maximum_suppression(boxes, scores[sure], overlap=_PLATE_OVERLAP)
    return WindowDetections(boxes[best], scores[sure][best])


class LpdYuNet:
    def __init__(self, model: bytes) -> None:
        self._model = np.frombuffer(model, np.uint8)
        self._priors = plate_priors(*PLATE_SIZE)

    def detect(self, pixels: NDArray[np.uint8], *, check: Callable[[], None] = never) -> list[Detection]:
        network = cv2.dnn.readNetFromONNX(self._model)  # not shared between threads, as for faces

        def detect(part: NDArray[np.uint8]) -> WindowDetections:
            network.setInput(cv2.dnn.blobFromImage(part))
            outputs = [np.asarray(array, np.float32) for array in network.forward(_OUTPUTS)]
            return decode_plates(outputs, self._priors)

        return detect_in_windows(
            pixels, detect, kind="plate", size=PLATE_SIZE, overlap=_PLATE_OVERLAP_PX, check=check
        )
