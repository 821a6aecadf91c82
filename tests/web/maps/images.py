"""An image for the maps of tests, and the positions of its corners."""

import io

from PIL import Image

CORNERS = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.098, "lon": 14.403}}


def png(size=(300, 200), colour="green"):
    """Return a picture of one colour as a file."""
    file = io.BytesIO()
    Image.new("RGB", size, colour).save(file, "PNG")
    file.seek(0)
    return file
