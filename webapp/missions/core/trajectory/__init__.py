"""Poses over time and the objects seen from them."""
