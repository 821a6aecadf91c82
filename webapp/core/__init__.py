"""Pure computation on arrays and values: no Flask, database, files, environment or terminal.

An estimate that can fail returns a falsy value with a reason; it never falls back to something that looks
like a result.
"""
