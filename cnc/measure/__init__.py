"""Measurements of a machine with what a shop has, and the keys of the machine file from them."""
