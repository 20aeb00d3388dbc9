"""How healthy bags are, and their repair."""
