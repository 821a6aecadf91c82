"""Import, export and duplication of maps."""
