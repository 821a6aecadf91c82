"""Signing in, accounts, and access."""
