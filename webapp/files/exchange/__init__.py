"""Formats for exchanging maps, tracks and answers."""
