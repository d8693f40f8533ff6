"""Kinematics: joints and tool tip, in both directions, with derivatives along a path."""
