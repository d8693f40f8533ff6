"""GRBL boards: driver, link, protocol."""
