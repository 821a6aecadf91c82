"""Positions on the Earth and on the map image."""
