"""Dynamics of everything on the table: bodies, drives, thrusters and the forces on them."""
