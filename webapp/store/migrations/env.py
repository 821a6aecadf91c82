"""Runs the migrations on the connection that `webapp.store.library` gives.

The first one makes the tables of 0.7.0. A new migration: change `schema.py`, then write
`versions/000N_what_it_does.py`; a test compares the two. If it does not only add what older programs need not
write, `EXPANDED_SINCE` in `webapp.store.library` has to follow.
"""

from alembic import context

from webapp.store.schema import Base

context.configure(
    connection=context.config.attributes["connection"], target_metadata=Base.metadata, render_as_batch=True
)
with context.begin_transaction():
    context.run_migrations()
