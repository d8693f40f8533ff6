"""The motion of axis words without a motion code: at the start, and after G80."""

from __future__ import annotations

import numpy as np
import pytest

from cnc.model.blocks import Polyline
from tests.support.gcode.gcode_cases import error_of, points, run, warnings


@pytest.mark.parametrize("dialect", ["fanuc", "auto"])
@pytest.mark.parametrize("before", ["", "G80\n", "G17 G40 G80\n"])
def test_a_first_move_without_a_motion_code_is_a_traverse_with_a_warning(
    dialect: str, before: str
) -> None:
    program = f"{before}Z5.\nX1."
    assert points(program, dialect) == [(0.0, 0.0, 5.0), (1.0, 0.0, 5.0)]
    assert [found.code for found in warnings(program, dialect)] == ["motion-assumed"]
    assert error_of(program, dialect="linuxcnc").code == "motion-missing"


HOLES = "G99 G81 X1. Y1. Z-1. R1. F100.\nX2.\nX3."
GO_ON = ["{move}\n{holes}", "{holes}\n{move}\nG81 X4. Z-2. R1. F100.\nX5."]


@pytest.mark.parametrize("lines", GO_ON)
@pytest.mark.parametrize("after", ["G80\nX7.\nX8.", "G80 X7.\nX8.", "G80 G98\n\nG80\nX7.\nX8."])
@pytest.mark.parametrize("move", ["G0 X5. Z3.", "G1 X5. Z3. F240."])
@pytest.mark.parametrize("dialect", ["auto", "fanuc", "haas"])
def test_a_move_after_g80_is_that_before_the_cycle(
    lines: str, after: str, move: str, dialect: str
) -> None:
    """Compiled code executes holes and moves; the motion before the cycle is known all the same."""
    program = "G0 X9.\n" + lines.format(move=move, holes=HOLES) + f"\n{after}"
    last = [block for block in run(program, dialect=dialect) if isinstance(block, Polyline)][-1]
    assert last.points[-2:, 0].tolist() == [7.0, 8.0]
    assert np.isnan(last.feeds[-2:]).tolist() == [move.startswith("G0")] * 2
    found = [each.code for each in warnings(program, dialect)]
    assert found == (["motion-assumed"] if dialect == "auto" else [])
    assert error_of(program, dialect="linuxcnc").code == "motion-missing"


def test_a_move_after_g80_is_reported_once() -> None:
    program = f"G0 X9\n{HOLES}\nG80\nX7\n{HOLES}\nG80\nX8\nG1 X9\n{HOLES}\nG80 X7"
    (found,) = warnings(program, "auto")
    assert (found.code, found.line) == ("motion-assumed", 6)
    last = [block for block in run(program, dialect="auto") if isinstance(block, Polyline)][-1]
    assert last.feeds[-1] == 100.0 / 60.0


def test_what_is_no_straight_motion_before_g80_is_not_assumed() -> None:
    for lines in ("G31 Z-5 F60", f"G0 X9\nG2 X2 Y2 R9 F60\n{HOLES}\nG80", f"{HOLES}\nG80"):
        assert error_of(f"{lines}\nX2", dialect="auto").code == "motion-missing"


def test_g80_beside_g28_returns_to_the_motion_before_the_cycle() -> None:
    program = f"G0 X9.\n{HOLES}\nG80 G28 Z0.\nX7."
    assert points(program, "fanuc")[-1][0] == 7.0
    assert error_of(program, dialect="linuxcnc").code == "motion-missing"
