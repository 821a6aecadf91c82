"""One module per file format: a strict reader, and a writer whose output it accepts."""
