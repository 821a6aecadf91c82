"""The map as a value, its edits as functions, and what can be wrong with it."""
