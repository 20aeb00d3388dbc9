"""Clearance of a moving arm from itself, its base and keep-out zones."""
