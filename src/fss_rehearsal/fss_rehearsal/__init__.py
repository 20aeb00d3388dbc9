"""Rehearsals: all nodes in a separate ROS domain, on the simulated test bed."""
