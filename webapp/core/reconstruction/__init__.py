"""Orientations of a map's photos, from matches between them and their known positions.

World frame: x east (map x), y down, z north (minus map y), all in map pixels. A rotation maps world
directions to camera directions (x right, y down, z forward).
"""
