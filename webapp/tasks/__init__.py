"""The use-cases, one a file: `run(..., settings, progress) -> report`, called by every front end."""
