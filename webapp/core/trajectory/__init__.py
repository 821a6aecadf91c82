"""Trajectories: positions over time."""
