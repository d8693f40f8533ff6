"""Curves of canonical blocks: lines, true arcs and helices, NURBS."""
