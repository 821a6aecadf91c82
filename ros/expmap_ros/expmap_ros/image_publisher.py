"""Node `image_publisher`: publishes a photo, the photos of a folder, a video, or a camera."""

from __future__ import annotations

from collections.abc import Generator
from pathlib import Path
from typing import Any

import cv2
from sensor_msgs.msg import CompressedImage, Image
from std_msgs.msg import Header

from expmap_ros import running
from expmap_ros.managed import ManagedNode
from expmap_ros.parameters import Parameter, ParameterError
from expmap_ros.pictures import Pixels, image_of

PARAMETERS = (
    Parameter("source", "", "A photo, a folder of photos, a video, or the number of a camera, such as '0'."),
    Parameter("rate_hz", 1.0, "Images a second.", limits=(0.01, 100.0)),
    Parameter("loop", True, "Begin again after the last one."),
    Parameter("image_transport", "raw", "Type of the images.", choices=("raw", "compressed")),
    Parameter("frame_id", "camera", "Frame of the images."),
)

PHOTOS = (".jpg", ".jpeg", ".png")
"""Suffixes of photos in a folder; a CompressedImage may hold JPEG and PNG."""

Frame = tuple[Pixels | None, bytes | None]
"""Decoded pixels (blue, green, red), and the bytes of the file if there is one."""


class ImagePublisher(ManagedNode):
    """Publishes images at a constant rate; the newest one is kept for late subscribers."""

    def __init__(self, **options: Any) -> None:
        super().__init__("image_publisher", PARAMETERS, **options)
        self._compressed = self._values["image_transport"] == "compressed"
        self.start()

    def configure(self) -> None:
        """Open the source. Raises ParameterError."""
        self._frames = self._all_frames()
        self.holds(self._frames.close)
        kind, ending = (CompressedImage, "/compressed") if self._compressed else (Image, "")
        self._publisher = self.advertise(kind, f"/gscam/image_raw{ending}", running.KEPT)
        self._next = next(self._frames)

    def activate(self) -> None:
        """Start to publish."""
        self._timer = self.repeat(1.0 / self._values["rate_hz"], self._publish)

    def _all_frames(self) -> Generator[Frame]:
        source = self._values["source"]
        if source.isdecimal():
            return _recorded(_opened(int(source), source), loop=False)
        path = Path(source).expanduser()
        if not source or not path.exists():
            raise ParameterError(f"source: {source!r} not found")
        photos = sorted(p for p in path.iterdir() if p.suffix.lower() in PHOTOS) if path.is_dir() else [path]
        if not photos:
            raise ParameterError(f"source: {source!r} has no photo ({', '.join(PHOTOS)})")
        if path.is_dir() or path.suffix.lower() in PHOTOS:
            return _files(photos, loop=self._values["loop"])
        return _recorded(_opened(str(path), source), loop=self._values["loop"])

    def _publish(self) -> None:
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._values["frame_id"])
        pixels, data = self._next
        if self._compressed:
            data = data or cv2.imencode(".jpg", pixels)[1].tobytes()
            kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
            self._publisher.publish(CompressedImage(header=header, format=kind, data=data))
        else:
            self._publisher.publish(image_of(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), header))
        following = next(self._frames, None)
        if following is None:
            self._timer.cancel()
            self.get_logger().info("the last image is published")
        else:
            self._next = following


def _files(photos: list[Path], *, loop: bool) -> Generator[Frame]:
    while True:
        for photo in photos:
            pixels = cv2.imread(str(photo))
            if pixels is None:
                raise ParameterError(f"source: {str(photo)!r} cannot be read")
            yield pixels, photo.read_bytes()
        if not loop:
            return


def _opened(name: int | str, source: str) -> cv2.VideoCapture:
    capture = cv2.VideoCapture(name)
    if not capture.isOpened():
        raise ParameterError(f"source: {source!r} cannot be opened")
    return capture


def _recorded(capture: cv2.VideoCapture, *, loop: bool) -> Generator[Frame]:
    """Read a video or a camera to its end; repeat it if `loop`."""
    try:
        while True:
            begun = False
            while (read := capture.read())[0]:
                begun = True
                yield read[1], None
            if not (loop and begun):
                return
            capture.set(cv2.CAP_PROP_POS_FRAMES, 0)
    finally:
        capture.release()


def main() -> None:
    """Run the node."""
    running.main(ImagePublisher)


if __name__ == "__main__":
    main()
