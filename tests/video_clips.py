"""Short videos for tests: a camera that pans over a picture of noise, with times and telemetry."""

import struct
from fractions import Fraction
from functools import cache

import cv2
import numpy as np

SIZE = (320, 240)
FPS = 12


@cache
def scenery(width=2000):
    """A picture with structure at all scales."""
    rng = np.random.default_rng(3)
    layers = [
        cv2.resize(
            rng.integers(0, 255, (240 // scale + 1, width // scale + 1, 3), dtype=np.uint8), (width, 240)
        )
        for scale in (4, 16, 48)
    ]
    return np.mean(layers, axis=0).astype(np.uint8)


def pan(positions, *, blurred=()):
    """Frames at horizontal positions of the scenery, some of them blurred."""
    wide = scenery()
    for number, left in enumerate(positions):
        frame = wide[:, int(left) : int(left) + SIZE[0]]
        yield cv2.GaussianBlur(frame, (0, 0), 4) if number in blurred else frame


def write_clip(path, frames, *, metadata=None, packets=()):
    """Write a video; `packets` are GPMF, one a second. A .mov keeps metadata of any name."""
    import av

    options = {"movflags": "use_metadata_tags"} if path.suffix == ".mov" else {}
    with av.open(str(path), "w", options=options) as out:
        out.metadata.update(metadata or {})
        stream = out.add_stream("mpeg4", rate=FPS)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = *SIZE, "yuv420p", 4_000_000
        data = None
        if packets:
            data = out.add_data_stream("bin_data")
            data.codec_tag = "gpmd"
            data.time_base = Fraction(1, 1000)
        for frame in frames:
            out.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="bgr24")))
        out.mux(stream.encode())
        for number, content in enumerate(packets):
            packet = av.Packet(content)
            packet.stream, packet.time_base = data, Fraction(1, 1000)
            packet.pts = packet.dts = 1000 * number
            packet.duration = 1000
            out.mux(packet)
    return path


def write_stream(path, frames, *, size, first):
    """Write an MPEG stream, to which another may be appended whose frames are counted from `first` on."""
    import av

    with av.open(str(path), "w", format="mpegts") as out:
        stream = out.add_stream("mpeg2video", rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = *size, "yuv420p", 4_000_000
        for number, frame in enumerate(frames, first):
            large = av.VideoFrame.from_ndarray(cv2.resize(frame, size), format="bgr24")
            large.pts = number
            out.mux(stream.encode(large))
        out.mux(stream.encode())


def klv(key, kind, *samples, size=None):
    """An item of GPMF; samples are packed by the letter of its type."""
    letters = {"l": "i", "L": "I", "S": "H", "\0": None, "c": None, "?": None}[kind]
    if letters is None:
        value = b"".join(samples)
        size, repeat = (size, len(value) // size) if size else (1, len(value))
    else:
        rows = [sample if isinstance(sample, tuple) else (sample,) for sample in samples]
        value = b"".join(struct.pack(f">{len(row)}{letters}", *row) for row in rows)
        size, repeat = len(value) // len(rows), len(rows)
    return struct.pack(">4sBBH", key.encode(), ord(kind), size, repeat) + value + b"\0" * (-len(value) % 4)


def gps5(places, *, fix=3):
    """A packet of a GoPro with positions (lat, lon)."""
    scale = klv("SCAL", "l", 10**7, 10**7, 1000, 1000, 100)
    rows = [(round(lat * 1e7), round(lon * 1e7), 1000, 0, 0) for lat, lon in places]
    return klv("DEVC", "\0", klv("STRM", "\0", klv("GPSF", "L", fix), scale, klv("GPS5", "l", *rows)))
