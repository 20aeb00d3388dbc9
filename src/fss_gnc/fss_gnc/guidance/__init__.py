"""Guidance of base and arm by activities, one at a time. Only `kinds` depends on ROS."""
