"""A photo of stripes, whose pictures show whether they are blurred."""

import io

import numpy as np
from PIL import Image

BOX = {"x": 0.25, "y": 0.25, "width": 0.5, "height": 0.5}


def stripes(quality=95):
    """Return a JPEG of stripes, which become grey when blurred."""
    pixels = np.zeros((120, 160, 3), np.uint8)
    pixels[:, ::2] = 255
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=quality)
    return file.getvalue()


def contrast(picture):
    """Return the contrast in the middle of a picture."""
    grey = np.asarray(Image.open(io.BytesIO(picture)).convert("L"), float)
    height, width = grey.shape
    return grey[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3].std()


def fetched(browser, address):
    with browser.get(address) as answer:
        assert answer.status_code == 200, address
        return answer.get_data()


def blur(browser, slug, *boxes, id=0):
    return browser.put(f"/api/v1/maps/{slug}/photos/{id}/blur", json={"boxes": list(boxes)})
