"""An invented park: the sample map, and ground truth for tests."""
