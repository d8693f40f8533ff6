"""Units: internally mm, s and mm/s, independent of the units of program and operator."""

MM_PER_INCH = 25.4
S_PER_MIN = 60.0


def per_second(per_minute: float) -> float:
    """Convert a rate per minute (mm/min, rev/min) to a rate per second."""
    return per_minute / S_PER_MIN


def per_minute(per_second: float) -> float:
    """Convert a rate per second to a rate per minute."""
    return per_second * S_PER_MIN
