"""Mathematics of the arm and its floating base: description, kinematics, dynamics, momentum."""
