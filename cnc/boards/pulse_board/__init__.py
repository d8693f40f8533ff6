"""Common parts of the drivers of boards that play pulses (stepper board, Klipper board)."""
