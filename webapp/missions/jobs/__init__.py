"""Long work on missions outside a request."""
