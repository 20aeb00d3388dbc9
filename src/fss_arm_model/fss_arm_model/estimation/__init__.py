"""Estimation of parameters from measurements: weighted least squares, statistics and outliers."""
