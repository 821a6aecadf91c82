"""Everything that is fetched from public services: map tiles, places, street-level photos, model weights."""
