"""Compiled algorithms of the papers."""
