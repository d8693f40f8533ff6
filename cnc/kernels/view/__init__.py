"""Compiled thinning of what is drawn."""
