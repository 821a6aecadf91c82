"""A radius in pixels keeps its length when a map gets another image."""

import pytest

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.store.schema import Photo
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.satellite.apply import ImageChange


def image(*, side, metres=None):
    """Return a square image, with a georeference if the size of its pixels is given."""
    plane = (metres, 0.0, 470_683.0, 0.0, -(metres or 0.0), 6_696_811.0, 0.0, 0.0, 1.0)
    return MapImage(side, side, None if metres is None else Georeference("EPSG:32635", plane, "corners"))


@pytest.mark.parametrize(
    ("old", "new", "options", "radius"),
    [
        (image(side=400, metres=0.2), image(side=800, metres=0.1), {}, 14.0),
        (image(side=400), image(side=800), {"scale": True}, 14.0),
        (image(side=400), image(side=800), {}, 7.0),
        (image(side=400), image(side=400, metres=0.1), {"same_file": True}, 7.0),
        (None, image(side=400), {}, 7.0),
    ],
)
def test_the_radius_of_a_suggested_place(old, new, options, radius):
    change = ImageChange(old, new, **{"same_file": False, **options})
    photo = Photo(x_px=40.0, y_px=50.0, radius_px=7.0)
    [spot] = change.moved([MapPixel(40.0, 50.0)])
    assert change.placed(photo, spot)["radius_px"] == pytest.approx(radius, rel=1e-6)
    assert "radius_px" not in change.placed(Photo(x_px=40.0, y_px=50.0), spot)
