"""Bags: reading, recording, replaying and repairing them."""
