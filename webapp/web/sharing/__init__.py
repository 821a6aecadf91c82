"""Pages and API of what is shared."""
