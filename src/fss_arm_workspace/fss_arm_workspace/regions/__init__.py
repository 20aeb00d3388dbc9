"""Regions of the plane that a tip reaches, bounded by circular arcs."""
