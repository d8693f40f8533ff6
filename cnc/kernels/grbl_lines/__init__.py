"""Compiled arc fit for lines of a GRBL board."""
