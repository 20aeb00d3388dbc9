"""Guidance, navigation and control of the floating base; so far navigation."""
