"""Execution of programs: lines in order, control flow, subprograms."""
