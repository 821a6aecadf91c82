"""Base maps: the image of a map as tiles for other programs, in one file."""

from webapp.connect import Registration

CONNECTION = Registration(
    "webapp.connect.basemaps.command:basemaps", "Write the image of a map as MBTiles, PMTiles or GeoTIFF."
)
