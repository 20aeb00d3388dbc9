"""Regions of the plane that the tip reaches, bounded by circular arcs."""
