"""Photos: pixels, EXIF, previews."""
