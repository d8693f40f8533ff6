"""Removal of material: the part that a program cuts from the stock."""
