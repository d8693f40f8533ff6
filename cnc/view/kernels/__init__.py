"""Compiled points of a drawn motion and their thinning."""
