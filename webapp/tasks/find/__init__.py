"""Search for the map of a photo, by localizing it on the most similar maps."""
