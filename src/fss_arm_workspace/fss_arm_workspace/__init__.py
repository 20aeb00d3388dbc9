"""Workspace and manipulability of the arm on a fixed and on a floating base."""

__version__ = "0.2.0"
