"""Plan to pulses and samples."""
