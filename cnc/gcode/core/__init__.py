"""The interpreter: modal state, coordinates, codes, cycles, splines and flow."""
