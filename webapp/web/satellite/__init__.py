"""Page and API of a map's image and its georeference."""
