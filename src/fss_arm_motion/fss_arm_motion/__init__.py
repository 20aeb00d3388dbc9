"""Motion planning for the arm on a floating base, and the guard that prevents collisions."""
