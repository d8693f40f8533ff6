"""Board drivers: loopback, file, GRBL, stepper, and the discovery of boards."""
