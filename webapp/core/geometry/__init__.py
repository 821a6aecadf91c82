"""Geometry of one and two views: rotations, relative pose, epipolar constraint."""
