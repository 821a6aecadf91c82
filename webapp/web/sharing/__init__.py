"""Pages and API of shared maps and answers."""
