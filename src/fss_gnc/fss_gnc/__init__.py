"""Guidance, navigation and control of the floating base: pose and twist, wrenches by valves."""
