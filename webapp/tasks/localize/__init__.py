"""From photos to positions: the index, calibration, localization, evaluation."""
