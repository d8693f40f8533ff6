"""cnc: a soft-CNC controller. G-code text in, jerk-limited step and direction pulses out."""

__version__ = "0.2.0"
