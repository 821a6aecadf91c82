"""Evaluates answers on photos with known positions."""
