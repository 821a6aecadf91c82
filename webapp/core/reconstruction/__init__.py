"""How a map's photos were held: orientations from what they see in common and their known positions.

World frame here: x east (map x), y down, z north (minus map y), all in map pixels. A rotation takes world
directions to camera directions (x right, y down, z forward).
"""
