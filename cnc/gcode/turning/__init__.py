"""Turning: cycles, threads, profiles and codes of lathes."""
