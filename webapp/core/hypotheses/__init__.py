"""Answers of localization: places, their probabilities, and the evidence for them."""
