"""The job queue, and snapshots of the database."""
