"""Compiled removal of material by a moving tool."""
