"""Manipulability of the tip: measure, best postures, maps."""
