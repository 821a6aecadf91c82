"""Positions over time, and photos matched with them by their times."""
