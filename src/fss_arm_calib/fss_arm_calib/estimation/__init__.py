"""Estimation: nonlinear least squares and its statistics."""
