"""Formats of tracks and of detected objects: readers and writers."""
