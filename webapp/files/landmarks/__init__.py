"""Reconstructions on disk: matches and models as pycolmap has them, pieces, and clouds of landmarks."""
