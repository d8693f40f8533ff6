"""Driver for GRBL boards: link, protocol, monitoring of faults."""
