"""Units: internally mm, s and mm/s, independent of the units of program and operator."""

from decimal import Decimal

MM_PER_INCH = 25.4
S_PER_MIN = 60.0


def per_second(per_minute: float) -> float:
    """Convert a rate per minute (mm/min, rev/min) to a rate per second."""
    return per_minute / S_PER_MIN


def per_minute(per_second: float) -> float:
    """Convert a rate per second to a rate per minute."""
    return per_second * S_PER_MIN


def decimal_text(value: float | Decimal, digits: int) -> str:
    """Return a number with at most so many decimals: no exponent, no zeros at the end, no -0."""
    text = f"{value:.{digits}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
