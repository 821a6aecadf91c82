"""An image for maps of tests, and where its corners are on the Earth."""

import io

from PIL import Image

CORNERS = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.098, "lon": 14.403}}


def png(size=(300, 200), colour="green"):
    """A picture of one colour, as a file to be sent."""
    file = io.BytesIO()
    Image.new("RGB", size, colour).save(file, "PNG")
    file.seek(0)
    return file
