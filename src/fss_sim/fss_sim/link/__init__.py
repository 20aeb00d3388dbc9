"""A link's electronics, emulated, and its ways to a driver."""
