"""Formats in which maps are exchanged."""
