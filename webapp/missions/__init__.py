"""Missions: tracks of robots and people, and detected objects. No other part of the program imports this."""
