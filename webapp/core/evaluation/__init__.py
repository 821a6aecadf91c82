"""Evaluation of answers against known positions."""
