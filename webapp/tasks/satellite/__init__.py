"""The image of a map and its georeference."""
