"""Compiled code of the reader and of statements that only move."""
