"""How far the tip goes in straight lines."""
