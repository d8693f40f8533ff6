"""Compression of steps for Klipper boards."""
