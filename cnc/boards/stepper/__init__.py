"""The stepper board: driver, protocol, segments."""
