"""Maps on their way in and out: import, export, copy."""
