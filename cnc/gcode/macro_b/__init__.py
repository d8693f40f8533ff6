"""Macro B: numbered programs, arguments and variables."""
