"""Readers of files with tracks: a module for each format, with its entry `FORMAT`."""
