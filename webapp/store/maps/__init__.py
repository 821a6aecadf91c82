"""Maps, their photos, edits and uploads."""
