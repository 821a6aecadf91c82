"""Moves all records from one kind of database to the other, and verifies that the copy is exact."""
