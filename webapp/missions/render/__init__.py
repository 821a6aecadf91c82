"""Pictures and pages of missions."""
