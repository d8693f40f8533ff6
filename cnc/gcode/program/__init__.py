"""Programs: lines in order, control flow, subprograms."""
