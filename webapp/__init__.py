"""Experience Map: finds where a photo was taken, on a map that users make themselves."""

__version__ = "1.0.0"
