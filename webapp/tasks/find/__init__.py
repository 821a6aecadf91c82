"""Which map is this? The maps that look most like a photo are searched for it."""
