"""Operation of a machine by one session: connect, jog, home, zero, MDI, run, hold, probe."""
