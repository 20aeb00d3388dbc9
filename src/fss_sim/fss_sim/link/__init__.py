"""Emulated electronics of a link, and their connections to a driver."""
