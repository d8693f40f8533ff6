"""Compiled curves: evaluation, arc length, B-splines, fits."""
