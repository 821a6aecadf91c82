"""Maps of the library: photos, positions, checks, edits, their files."""
