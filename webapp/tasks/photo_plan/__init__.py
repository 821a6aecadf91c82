"""Plans of where the next photos of a map help most, and intake of the photos taken there."""
