"""Positions on the Earth and on the map image, with these conventions.

Map pixels
    `MapPixel(x, y)`: x to the right, y down, (0, 0) is the outer corner of the top-left pixel, so that an
    image of width w and height h covers 0 <= x <= w, 0 <= y <= h, and its first pixel's centre is (0.5, 0.5).
    Floats in the program; integers, rounded half up, in a `.cfg`.

Half a pixel
    Keypoints (OpenCV) and world files have the origin at the centre of the first pixel: their reader adds
    half a pixel. GeoTIFFs, as GDAL reads them, have it at the outer corner too.

Latitude and longitude
    Degrees north and degrees east on WGS 84. `LatLon` and every (n, 2) array called `latlon` have the
    latitude first. Only the plane of a georeference (`plane_from_pixel`, `crs`) has x = east or longitude
    first, y = north or latitude second, for every coordinate system, whatever axis order it defines.

Headings
    Degrees clockwise from true north, 0 <= heading < 360. `Georeference.north_deg` says where north points in
    the image; without a georeference, image-up is north. Radians are only used inside functions.

Local metres
    `EnuMetres`: metres east, north and up of an origin, in the azimuthal equidistant plane of `local`:
    distance and azimuth from the origin are the geodesic's. Heights are neither used nor changed.

No counterpart
    A position without a counterpart (beyond a horizon or the domain of a coordinate system, or NaN) is
    converted to NaN: no exception, and not the nearest valid one. If no georeference can be made, a
    `GeoreferenceError` is raised.
"""
