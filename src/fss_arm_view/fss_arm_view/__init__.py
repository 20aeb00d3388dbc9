"""Computation and display of the base's reaction to the arm."""
