"""The free-floating test bed, simulated: plant, sensors, link electronics."""
