"""Health checks and repair of bags."""
