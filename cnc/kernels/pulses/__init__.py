"""Compiled interpolators."""
