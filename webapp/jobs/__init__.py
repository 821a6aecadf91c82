"""Long work outside a request: the table of its kinds, the worker that does it, and who keeps all running."""
