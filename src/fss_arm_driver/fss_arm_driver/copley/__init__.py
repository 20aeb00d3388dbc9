"""Copley servo drive directly on the computer's serial port, without a microcontroller."""
