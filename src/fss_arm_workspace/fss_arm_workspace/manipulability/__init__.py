"""How well the tip can be moved: measure, best postures, maps."""
