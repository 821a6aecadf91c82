"""The differences between SQLite and PostgreSQL; all other code is the same for both."""
