"""The use-cases, one a file: `run(..., settings, progress) -> report`, called by the front ends and the tests."""
