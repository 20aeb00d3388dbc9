"""What base and arm are to do: activities, one at a time. No ROS but in `kinds`."""
