"""Database records of missions."""
