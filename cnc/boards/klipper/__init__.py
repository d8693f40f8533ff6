"""Driver and simulator of boards with Klipper's firmware."""
