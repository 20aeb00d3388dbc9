"""The base's reaction to the arm, computed and shown."""
