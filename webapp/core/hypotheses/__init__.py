"""What localization answers: places, their probabilities, and why."""
