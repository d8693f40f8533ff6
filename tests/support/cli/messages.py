"""Messages of the command line."""

from __future__ import annotations


def last_message(err: str, code: str) -> str:
    """Return the first line of the last diagnostic; only source line, caret and help follow."""
    lines = err.rstrip("\n").split("\n")
    first = max(number for number, line in enumerate(lines) if f"{code}: " in line)
    assert all(line.startswith("  ") for line in lines[first + 1 :])
    assert "Traceback" not in err
    return lines[first]
