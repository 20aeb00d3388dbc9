"""Constants that several packages need."""

GRAVITY = 9.81  # [m/s^2]
SECOND = 1_000_000_000  # [ns]
