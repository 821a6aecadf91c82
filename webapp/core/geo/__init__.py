"""Positions on the Earth and on the map image: the conventions, in one place.

Map pixels
    `MapPixel(x, y)`: x to the right, y down, (0, 0) is the outer corner of the top-left pixel, so that an
    image of width w and height h covers 0 <= x <= w, 0 <= y <= h, and its first pixel's centre is (0.5, 0.5).
    Floats inside the program; whole numbers, rounded half up, in a `.cfg`.

Half a pixel
    Keypoints (OpenCV) and world files count from the centre of the first pixel: their reader adds
    the half. GeoTIFFs as GDAL reads them count from the outer corner too.

Latitude and longitude
    Degrees north and degrees east on WGS 84. `LatLon` and every (n, 2) array called `latlon` have the
    latitude first. Only the plane of a georeference (`plane_from_pixel`, `crs`) has x = east or longitude
    first, y = north or latitude second, for every coordinate system, whatever its authority wrote down.

Headings
    Degrees clockwise from true north, 0 <= heading < 360. `Georeference.north_deg` says where north points in
    the image; without a georeference, up is north. Radians only inside a function.

Local metres
    `EnuMetres`: metres east, north and up of an origin, in the azimuthal equidistant plane of `local`:
    distance and azimuth from the origin are the geodesic's. Heights are neither used nor changed.

No counterpart
    A position that has none on the other side (beyond a horizon, a coordinate system's reach, NaN) is NaN,
    never an exception and never the nearest valid one. Where no georeference can be made, it is a
    `GeoreferenceError`.
"""
