"""Landmarks: points that several photos of a map show, and what follows from them."""
