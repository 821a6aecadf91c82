"""Sign-in, accounts, and access control."""
