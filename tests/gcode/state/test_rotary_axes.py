"""Rotary axes that repeat after 360 degrees: ends and directions of absolute moves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.gcode.core.coordinates import RotaryAxes
from cnc.gcode.core.program import ProgramOptions, interpret
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Polyline
from cnc.model.diagnostics import GcodeError

AXES = ("x", "y", "z", "a", "c")
ANGLES = st.floats(-1000.0, 1000.0)


def ends(program: str, dialect: str, rule: str | None = "dialect", axis: str = "a") -> list[float]:
    """Return the positions of an axis at the ends of the moves."""
    options = ProgramOptions(wraps={} if rule is None else {axis: rule})
    text = Text.of_lines(program.split("\n"), "t")
    blocks = interpret(text, axes=AXES, dialect=dialect, options=options)
    points = [block.points for block in blocks if isinstance(block, Polyline)]
    return np.concatenate(points)[:, AXES.index(axis)].tolist()


@pytest.mark.parametrize(
    ("dialect", "program", "expected"),
    [
        # FANUC, parameter 1008: the shortest way; half a turn is positive
        ("fanuc", "G90 G0 A350.\nA10.\nA190.\nA350.\nA0.", [-10, 10, 190, 350, 360]),
        ("fanuc", "G90 G0 A200.\nG91 A300.\nG90 A10.", [-160, 140, 10]),
        ("haas", "G90 G0 A270.", [-90]),
        # LinuxCNC, WRAPPED_ROTARY: the sign of the word is the direction
        ("linuxcnc", "G90 G0 A90\nA10\nA-350\nA-350\nA-0\nA0\nM2", [90, 370, 350, 350, 0, 0]),
        ("linuxcnc", "G90 G0 A90\nG91 A-500\nG90 A0\nM2", [90, -410, -360]),
        # SINUMERIK: AC stays within the turn, DC is the shortest way
        ("siemens", "G90 G0 A350\nA10\nA=DC(350)\nA=ACP(340)\nA=ACN(350)\nA=AC(20)",
         [350, 10, -10, 340, -10, -340]),
        ("siemens", "G91 G0 A=DC(350)\nA=ACP(0)\nA=IC(500)\nA=ACN(0)", [-10, 0, 500, 360]),
        ("siemens", "G90 G0 A=IC(500)\nA=IC(-20)", [500, 480]),
        ("grbl", "G90 G0 A270", [-90]),
    ],
)  # fmt: skip
def test_ends_follow_the_dialect(dialect: str, program: str, expected: list[float]) -> None:
    assert ends(program, dialect) == pytest.approx(expected, abs=1e-9)


def test_the_machine_file_may_name_the_rule() -> None:
    assert ends("G90 G0 A90.\nA10.", "fanuc", "sign") == pytest.approx([90, 370])
    assert ends("G90 G0 A350\nA10\nM2", "linuxcnc", "shortest") == pytest.approx([-10, 10])
    assert ends("G90 G0 A350\nA700\nM2", "linuxcnc", None) == pytest.approx([350, 700])


def test_directions_of_siemens_need_no_wrapped_axis() -> None:
    assert ends("G90 G0 A350\nA=ACP(10)\nA=IC(20)\nA5", "siemens", None) == pytest.approx(
        [350, 370, 390, 5]
    )


def test_offsets_shift_the_turn() -> None:
    program = "G90 G10 L2 P1 A30\nG0 A0\nA350\nG53 G0 A0\nG92 A0\nA-10\nM2"
    assert ends(program, "linuxcnc") == pytest.approx([30, 380, 720, 370])


@pytest.mark.parametrize(
    ("dialect", "line", "column"),
    [("linuxcnc", "G0 X1 A360", 7), ("siemens", "G0 A-10", 4), ("siemens", "G0 A=DC(1) C1", 0)],
)
def test_angles_beyond_a_turn_are_refused(dialect: str, line: str, column: int) -> None:
    if not column:
        assert ends(line, dialect) == [1]
        return
    with pytest.raises(GcodeError) as caught:
        ends(f"G90\n{line}\nM2", dialect)
    found = caught.value.diagnostic
    assert (found.code, found.line, found.column) == ("wrapped-axis-range", 2, column)


def test_dc_is_for_rotary_axes() -> None:
    with pytest.raises(GcodeError, match="code-not-supported"):
        ends("G90 G0 X=DC(10)", "siemens")


@given(value=ANGLES, here=ANGLES)
def test_the_shortest_way_is_at_most_half_a_turn(value: float, here: float) -> None:
    end = RotaryAxes(AXES, {"a": "shortest"}, "sign").end(3, value, here)
    assert -180.0 - 1e-9 <= end - here <= 180.0 + 1e-9
    assert math.isclose(math.remainder(end - value, 360.0), 0.0, abs_tol=1e-9)


@given(angle=st.floats(0.0, 359.9), negative=st.booleans(), here=ANGLES)
def test_the_sign_is_the_direction(angle: float, negative: bool, here: float) -> None:
    value = -angle if negative else angle
    end = RotaryAxes(AXES, {"a": "sign"}, "shortest").end(3, value, here)
    moved = end - here
    assert -360.0 <= moved <= 1e-7 if negative else -1e-7 <= moved <= 360.0
    assert math.isclose(math.remainder(end - angle, 360.0), 0.0, abs_tol=1e-9)


def test_a_place_that_rounding_has_moved_needs_no_turn() -> None:
    axes = RotaryAxes(AXES, {"a": "sign"}, "shortest")
    assert axes.end(3, 30.0, 390.0 + 1e-10) == 390.0
    assert axes.end(3, -30.0, 390.0 - 1e-10) == 390.0
