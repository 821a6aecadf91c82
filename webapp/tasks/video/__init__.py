"""Photos from videos."""
