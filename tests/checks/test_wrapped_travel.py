"""Soft limits of rotary axes that repeat after 360 degrees: the place within the turn counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from cnc.api import RunOptions, check
from cnc.machine.load import inconsistencies
from cnc.machine.models import Axis, Board, Machine, PathLimits
from tests.support.five_axis import five_axis_machine


def machine(travel: tuple[float, float]) -> Machine:
    axis = Axis(steps_per_mm=10.0, max_velocity=100.0, max_acceleration=1000.0, max_jerk=20_000.0)
    c = axis.model_copy(update={"travel": travel, "wrap": "in-turn"})
    return Machine(axes={"x": axis, "c": c}, path=PathLimits(), board=Board(max_step_rate=1e9))


@pytest.mark.parametrize(
    ("travel", "moves", "lines"),
    [
        ((0.0, 270.0), "G0 C200\nC10\nC270", []),
        ((0.0, 270.0), "G0 C280\nC10", [2, 3]),
        ((0.0, 270.0), "G91 G0 C100\nC180", [3]),
        ((0.0, 270.0), "G91 G0 C-10", [2]),
        ((-10.0, 350.0), "G91 G0 C1000\nC-2000", []),
    ],
)
def test_the_place_within_the_turn_is_compared(
    travel: tuple[float, float], moves: str, lines: list[int], tmp_path: Path
) -> None:
    file = tmp_path / "part.ngc"
    file.write_text(f"G21 G90\n{moves}\nM2\n")
    report = check(file, machine(travel), RunOptions(dialect="linuxcnc"))
    faults = [fault.diagnostic for fault in report.faults]
    assert [each.line for each in faults] == lines
    assert {each.code for each in faults} <= {"soft-limit"}


def test_only_rotary_axes_may_repeat() -> None:
    found = five_axis_machine("xyzac")
    x = found.axes["x"].model_copy(update={"wrap": "sign"})
    wrong = found.model_copy(update={"axes": found.axes | {"x": x}})
    assert [each.key for each in inconsistencies(wrong)] == [("axes", "x", "wrap")]
