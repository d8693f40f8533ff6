"""Kernels of :mod:`cnc.gcode`: the scanner, and runs of straight moves."""
