"""Maintenance of a library: backup, restore, moves, clean-up."""
