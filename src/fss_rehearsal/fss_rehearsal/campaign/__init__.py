"""Campaigns: many runs of one function over a grid, distributions and seeds."""
