"""Rehearsals: the whole graph in a ROS domain of its own, on the simulated test bed."""
