"""Retrieval of map photos that may show the same scene as a query: search engines and the shortlist."""
