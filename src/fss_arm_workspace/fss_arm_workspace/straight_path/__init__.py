"""Straight-path workspace: lengths of the tip's straight paths."""
