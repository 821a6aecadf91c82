"""Background jobs: the table of their kinds, the worker that runs them, and the processes' supervisor."""
