"""Checks of a program: travel, stock, arcs, feeds, portability, changes since a baseline."""
