"""LinuxCNC's numbers of spindles: $0 and $-1 beside the codes of a spindle."""

from __future__ import annotations

import pytest

from cnc.model.blocks import Spindle
from tests.support.gcode.gcode_cases import error_of, run


@pytest.mark.parametrize("dialect", ["linuxcnc", "auto"])
@pytest.mark.parametrize(
    "line",
    ["M3 S1200 $0", "M3 $0 S1200", "S1200 $-1 M3", "G97 S1200 $0\nM3 $0", "m3s1200$0 (a $5)"],
)
def test_the_first_spindle_may_be_named(dialect: str, line: str) -> None:
    found = [each for each in run(f"G21\n{line}\nM2", dialect=dialect) if isinstance(each, Spindle)]
    assert [(each.state, each.rpm) for each in found] == [("cw", 1200.0), ("off", 0.0)]


@pytest.mark.parametrize("line", ["M3 S100 $1", "G0 X1 $0", "M3 S100 $0.5", "M30 $0"])
def test_other_numbers_and_places_are_refused(line: str) -> None:
    assert error_of(f"G21\n{line}\nM2", dialect="linuxcnc").code == "character-unknown"


def test_fanuc_has_no_such_number() -> None:
    assert error_of("M3 S100 $0\nM30", dialect="fanuc").code == "character-unknown"
