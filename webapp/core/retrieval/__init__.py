"""Which photos of a map may show what a query shows: search engines and the shortlist."""
