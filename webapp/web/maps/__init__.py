"""Pages and API of maps, photos and placements."""
