"""Satellite images: raster formats, pyramids, and files with their georeference."""
