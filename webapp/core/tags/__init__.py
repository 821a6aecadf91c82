"""Printed tags (AprilTag, ArUco): found in photos, and cameras solved from them."""
