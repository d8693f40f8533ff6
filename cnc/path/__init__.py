"""Canonical blocks to curves: lines, true arcs and helices, NURBS."""
