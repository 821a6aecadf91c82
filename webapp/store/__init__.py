"""The records of the library: accounts, maps, photos, edits, uploads and jobs, in one SQL database.

The database is authoritative for maps in the library; `map.cfg` and `map.json` are exports of it. There is
one module per noun, with functions that take a session (a writing one if they change something); `database`
opens sessions, `schema` has the tables.
"""
