"""Compiled planner: bounds, look-ahead, refinement, corners, audit."""
