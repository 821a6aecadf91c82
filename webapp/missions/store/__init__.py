"""The records of missions."""
