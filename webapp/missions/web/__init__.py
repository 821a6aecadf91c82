"""Pages and API of missions."""
