"""Accounts, members of maps, and sign-in."""
