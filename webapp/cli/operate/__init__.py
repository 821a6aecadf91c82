"""Commands that look after a whole library: backups, and moving its records."""
