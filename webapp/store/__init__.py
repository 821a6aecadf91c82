"""The records of the library: accounts, maps, photos, edits, uploads and jobs, in one SQL database.

The database is the truth about a map in the library; `map.cfg` and `map.json` are its exports. One module a
noun, each with functions that take a session, one that writes where they change something; `database` opens
sessions, `schema` has the tables.
"""
