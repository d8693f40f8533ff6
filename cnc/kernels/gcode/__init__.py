"""Compiled scanner and builder for plain lines."""
