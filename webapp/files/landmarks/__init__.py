"""Reconstructions on disk: pycolmap's matches and models, submodels, and clouds of landmarks."""
