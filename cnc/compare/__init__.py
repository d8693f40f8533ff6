"""Comparison of two programs: the largest distance of their toolpaths, lengths and times."""
