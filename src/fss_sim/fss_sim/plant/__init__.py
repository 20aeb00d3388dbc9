"""What moves on the table: bodies, drives, thrusters, and all that acts on them."""
