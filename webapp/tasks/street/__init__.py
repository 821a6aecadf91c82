"""Street-level photos from services: what an area has, and how it comes into a map."""
