"""Canned cycles: drilling and threading."""
