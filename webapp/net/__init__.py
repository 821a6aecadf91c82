"""Clients of public services: map tiles, place search, street-level photos, model weights."""
