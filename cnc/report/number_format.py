"""Numbers, times and coordinates as text for people."""

from __future__ import annotations


def clock(seconds: float) -> str:
    """Return seconds as h:mm:ss; below a minute as seconds with milliseconds."""
    if seconds < 60.0 and round(seconds, 3) < 60.0:
        return f"{seconds:.3f} s"
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def number(value: float | None) -> str:
    """Return a number with about six digits, with spaces from 10 000 on; a dash for None."""
    if value is None:
        return "-"
    if abs(value) >= 1e4:
        return spaced(round(value))
    if value != 0 and abs(value) < 1e-3:
        return f"{value:.3g}"
    return f"{value:.6g}"


def spaced(count: int) -> str:
    """Return a whole number; from 10 000 on with spaces between the thousands."""
    return f"{count:,}".replace(",", " ") if abs(count) >= 10_000 else str(count)


def position(value: float) -> str:
    """Return a coordinate in mm to 0.1 micrometres."""
    digits = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if digits == "-0" else digits
