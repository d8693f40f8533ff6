"""Splines and NURBS in the words of each dialect."""
