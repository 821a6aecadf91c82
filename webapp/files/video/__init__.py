"""Videos: their frames, and the positions that cameras and drones store in or beside them."""
