"""Compiled fit of lines and arcs for a GRBL board."""
