"""Runs of the test bed with drivers and applications in one loop, without ROS."""
