"""Planned motion of the arm on a floating base, and the guard that keeps it clear."""
