"""Emulated board of the base, and its connection to a driver."""
