"""Klipper's message protocol, without input and output."""
