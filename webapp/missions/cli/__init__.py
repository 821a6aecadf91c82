"""The commands `expmap mission` and `expmap robot`."""
