"""Missions: where robots and people were, and what they saw. Nothing else in the program imports this."""
