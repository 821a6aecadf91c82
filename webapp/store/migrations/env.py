"""Runs the migrations on the connection that `webapp.store.library` passes.

The first one creates the tables of 0.7.0. To add a migration, change `schema.py` and write
`versions/000N_what_it_does.py`; a test compares the two. If it does more than add what older programs need
not write, `EXPANDED_SINCE` in `webapp.store.library` must be set to it.
"""

from alembic import context

from webapp.store.schema import Base

context.configure(
    connection=context.config.attributes["connection"], target_metadata=Base.metadata, render_as_batch=True
)
with context.begin_transaction():
    context.run_migrations()
