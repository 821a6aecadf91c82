"""What differs between SQLite and PostgreSQL; all else of the program is the same on both."""
