"""Photos of a folder and a video are published, also to late subscribers."""

import cv2
import numpy as np
import pytest
from sensor_msgs.msg import CompressedImage, Image

from expmap_ros.image_publisher import ImagePublisher
from expmap_ros.parameters import ParameterError
from expmap_ros.pictures import pixels_of
from expmap_ros.running import KEPT
from ros.expmap_ros.test.support import textured


def test_the_photos_of_a_folder_come_in_turn(bench, survey):
    bench.start(ImagePublisher, source=str(survey / "photos"), rate_hz=20.0)
    heard = bench.listen(Image, "/gscam/image_raw", KEPT)
    bench.until(lambda: len(heard) >= 8)
    files = [cv2.imread(str(path)) for path in sorted((survey / "photos").glob("*.jpg"))]
    shown = {n for m in heard for n, p in enumerate(files) if np.array_equal(p, pixels_of(m)[..., ::-1])}
    assert len(shown) >= 2, "only the newest waits, so some may be missing"
    assert heard[0].header.frame_id == "camera" and heard[0].header.stamp.sec > 0


def test_a_compressed_photo_is_the_file_and_waits_for_late_listeners(bench, survey):
    photo = survey / "photos" / "3.jpg"
    bench.start(ImagePublisher, source=str(photo), loop=False, rate_hz=50.0, image_transport="compressed")
    bench.until(lambda: bench.node.count_publishers("/gscam/image_raw/compressed"))
    heard = bench.listen(CompressedImage, "/gscam/image_raw/compressed", KEPT)
    bench.until(lambda: heard)
    assert bytes(heard[0].data) == photo.read_bytes() and heard[0].format == "jpeg"


def test_a_video_is_played_to_its_end(bench, tmp_path):
    path = tmp_path / "video.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (320, 240))
    assert writer.isOpened()
    for seed in range(3):
        writer.write(textured(seed))
    writer.release()
    heard = bench.listen(Image, "/gscam/image_raw", KEPT)
    bench.start(ImagePublisher, source=str(path), loop=False, rate_hz=5.0)
    last = textured(2).astype(int)

    def shows_the_last():
        return heard and np.abs(pixels_of(heard[-1])[..., ::-1] - last).mean() < 8

    bench.until(shows_the_last)


@pytest.mark.parametrize("source", ["", "nowhere.jpg", "EMPTY"])
def test_a_source_that_is_none_is_named(bench, tmp_path, source):
    with pytest.raises(ParameterError, match="source"):
        bench.start(ImagePublisher, source=str(tmp_path) if source == "EMPTY" else source)
