"""Reconstructions on disk: matches and models as pycolmap has them, submodels, and clouds of landmarks."""
