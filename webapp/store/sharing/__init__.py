"""Views that are open without a sign-in."""
