"""Suggesting what is to be blurred in photos, and blurring it."""
