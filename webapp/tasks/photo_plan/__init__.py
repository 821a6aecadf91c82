"""Where the next photos of a map help most, and photos that were taken there."""
