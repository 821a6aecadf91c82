"""Maps in and out through the API."""
