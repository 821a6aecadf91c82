"""Measures how good answers are, on photos whose places are known."""
