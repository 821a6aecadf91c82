"""Structure from motion of a map's photos, and its applications."""
