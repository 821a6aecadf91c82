"""Copies of all records from one kind of database to the other, exact and compared."""
