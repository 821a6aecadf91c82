"""What keeps a server running: jobs, health checks, metrics, and models."""
