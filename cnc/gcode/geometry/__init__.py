"""Geometry of arcs and of cutter radius compensation."""
