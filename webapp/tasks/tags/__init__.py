"""Printed tags of a map in queries and in its photos."""
