"""Lint rules: warnings and notes about a program."""
