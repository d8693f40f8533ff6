"""Experiments of the three papers behind the interpolators: published and own values."""
