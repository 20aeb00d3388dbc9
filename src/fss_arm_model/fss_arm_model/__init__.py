"""The arm and its floating base as mathematics: description, kinematics, dynamics, momentum."""
