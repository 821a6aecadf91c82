"""A synthetic park: the sample map, and ground truth for tests."""
