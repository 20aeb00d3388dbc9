"""The drives' own parameters: torque constant, friction, torque sensor, rotor."""
