"""Photos that place themselves: submodels of a reconstruction, laid on the map by their placed photos.

A submodel comes from structure from motion, in a world of its own: its position, direction and scale are
free. Cameras have x to the right, y down and z forward; a rotation takes directions of the world to the
camera's.
"""
