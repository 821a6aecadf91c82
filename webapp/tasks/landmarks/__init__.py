"""Structure from motion of a map's photos, and what it is used for."""
