"""Codes that a typing error may have turned into another one."""

from __future__ import annotations


def near(written: str, legal: frozenset[float]) -> list[str]:
    """Return codes that a typing error may have turned into the one written.

    The errors are a missing point, another digit after it, a digit too many, two digits swapped.
    """
    before, point, _ = written.lstrip("0").partition(".")
    places = range(1, len(before))
    if point:
        slips = [before, *(f"{before}.{digit}" for digit in range(1, 6))]
    else:
        slips = [f"{before[:at]}.{before[at:]}" for at in places if before[at:].strip("0")]
        slips += [before[:at] + before[at + 1 :] for at in places]
        slips += [
            before[: at - 1] + before[at] + before[at - 1] + before[at + 1 :] for at in places
        ]
    numbers = dict.fromkeys(float(slip) for slip in slips if slip)
    return [f"{number:g}" for number in numbers if number in legal][:3]
