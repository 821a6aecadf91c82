"""Maps of the library: photos, positions, checks, edits and files."""
