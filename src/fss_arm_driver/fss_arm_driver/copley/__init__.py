"""A Copley servo drive straight on the computer's serial port, without a micro-controller."""
