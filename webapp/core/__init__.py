"""Arrays and values only: no Flask, no database, no file, no environment, no terminal.

An estimate that can fail returns a falsy value with a reason; it never falls back to something that looks
like a result.
"""
