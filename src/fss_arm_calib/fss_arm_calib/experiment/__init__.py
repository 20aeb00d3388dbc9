"""The experiment: which postures and maneuvers, and the node that makes them."""
