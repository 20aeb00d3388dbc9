"""Dynamic calibration: masses, centres of mass and inertias."""
