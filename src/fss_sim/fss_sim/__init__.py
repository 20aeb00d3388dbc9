"""Simulation of the free-floating test bed: plant, sensors, link electronics."""
