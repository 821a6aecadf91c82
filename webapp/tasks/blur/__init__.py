"""Suggestion and application of blur boxes in photos."""
