"""Segments of streams: where the arm rested, moved and drifted."""
