"""Runs a plan on a board."""
