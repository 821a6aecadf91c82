"""Pictures and reports of results, for people."""
