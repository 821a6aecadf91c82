"""Unusual photo files that no camera writes."""

import io

from PIL import Image


def progressive_jpeg(scans, *, size=(400, 300)):
    """Make a progressive JPEG whose last scan is repeated."""
    file = io.BytesIO()
    Image.new("L", size, 128).save(file, "JPEG", progressive=True)
    data = file.getvalue()
    last = data[data.rfind(b"\xff\xc4", 0, data.rfind(b"\xff\xda")) : -2]
    return data[:-2] + last * (scans - data.count(b"\xff\xda")) + data[-2:]
