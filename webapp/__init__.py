"""Experience Map: where was this photo taken, on a map that people make themselves."""

__version__ = "0.7.0"
