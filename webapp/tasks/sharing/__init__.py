"""What is prepared before a map is shown to others."""
