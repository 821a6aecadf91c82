"""The map as an immutable value, and checks of it."""
