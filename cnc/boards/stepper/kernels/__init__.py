"""Compiled segments of the stepper board."""
