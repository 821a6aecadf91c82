"""Where something was, over time."""
