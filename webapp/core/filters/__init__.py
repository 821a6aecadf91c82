"""Conditions on the rows of a table, as people write them: `class = 'car' AND confidence > 0.5`.

A text becomes a tree of values (`parser.py`); nothing of it is ever pasted into another language. Each
error has the position of the character that it is about.
"""
