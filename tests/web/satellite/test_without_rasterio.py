"""Without the extra `geotiff`, PNG and JPEG images work as usual; a TIFF gives an error with a hint."""

from tests.web.satellite.images import CORNERS, geotiff, png
from webapp.extras import install_line


def test_a_png_is_set_and_a_tiff_is_a_4xx_that_names_the_extra(put, absent):
    tiff = geotiff()
    absent("geotiff")
    assert put(png(300, 200), corners=CORNERS).status_code == 200
    answer = put(tiff, name="image.tif")
    assert answer.status_code == 422
    assert install_line("geotiff") in answer.json["error"]["hint"]
