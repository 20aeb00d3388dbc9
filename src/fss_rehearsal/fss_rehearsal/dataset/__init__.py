"""Public data set of calibration experiments on simulated arms, with their truth."""
