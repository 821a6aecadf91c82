"""Submodels of a reconstruction, aligned with the map by their placed photos, which places the other photos.

A submodel comes from structure from motion, in a world frame of its own, with arbitrary position, orientation
and scale. Cameras have x to the right, y down and z forward; a rotation takes directions of the world to the
camera's.
"""
