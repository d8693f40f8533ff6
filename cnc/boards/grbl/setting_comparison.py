"""Comparison of a board's settings with the machine file, before a run.

The board moves by its own settings. A check without the board computes with the machine file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cnc.boards.grbl.setting_changes import differing, expected_by
from cnc.boards.grbl.settings import ACCELERATIONS, NAMES, RATES, STEPS, TRAVELS, BoardInfo
from cnc.machine.models import Machine
from cnc.model.diagnostics import Diagnostic

PER_AXIS = 10
"""Numbers from the first setting of one quantity to the first of the next."""


def differences(info: BoardInfo, machine: Machine) -> list[Diagnostic]:
    """Return a warning with the settings that differ and both numbers, or nothing."""
    expected = differing(info, expected_by(machine, info))
    limits = [number for number in expected if _is_of(number, RATES, ACCELERATIONS)]
    groups = (
        ("moves take longer than checked", [n for n in limits if _own(info, n) < expected[n]]),
        (
            "moves are faster than the file allows",
            [n for n in limits if _own(info, n) > expected[n]],
        ),
        ("other steps/mm", [n for n in expected if _is_of(n, STEPS)]),
        ("another travel", [n for n in expected if _is_of(n, TRAVELS)]),
    )
    parts = [f"{effect}: {_both(info, expected, numbers)}" for effect, numbers in groups if numbers]
    if not parts:
        return []
    message = f"the board has other settings than the machine file; {'; '.join(parts)}"
    hint = "correct the machine file or the board: cncrun settings shows both"
    return [Diagnostic("board-differs", message, hint=hint, severity="warning")]


def _both(info: BoardInfo, expected: Mapping[int, float], numbers: Sequence[int]) -> str:
    return ", ".join(
        f"${number} {NAMES[number]} {_own(info, number):.10g} (file {expected[number]:.10g})"
        for number in sorted(numbers)
    )


def _is_of(number: int, *firsts: int) -> bool:
    return any(first <= number < first + PER_AXIS for first in firsts)


def _own(info: BoardInfo, number: int) -> float:
    return info.number(number) or 0.0
