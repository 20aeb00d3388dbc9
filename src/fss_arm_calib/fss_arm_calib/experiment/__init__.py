"""Experiment: choice of postures and maneuvers, and the node that executes them."""
