"""Boards: who takes pulses or lines."""
