"""Accounts, members of maps, and ways to sign in."""
