"""Pages and API of localization and its quality."""
