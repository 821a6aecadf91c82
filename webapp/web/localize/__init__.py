"""Pages and API of localization and its evaluation."""
