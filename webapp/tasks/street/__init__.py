"""Street-level photos from services: survey of an area, and import into a map."""
