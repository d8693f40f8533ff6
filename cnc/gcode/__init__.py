"""The G-code language: program text to canonical blocks."""
