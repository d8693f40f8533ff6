"""P of an arc: its turns, and the most that are allowed."""

from __future__ import annotations

import pytest

from cnc.gcode.core.program import interpret
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import ArcFeed
from cnc.model.diagnostics import GcodeError


def turns_of(line: str) -> float:
    blocks = interpret(Text.of_lines(["G21 G90 G17 F600", line, "M2"], "t"))
    (arc,) = [block for block in blocks if isinstance(block, ArcFeed)]
    return arc.turns


@pytest.mark.parametrize(
    ("line", "turns"),
    [
        ("G2 I5 P1", -1.0),
        ("G3 I5 P999", 999.0),
        ("G2 I5 P1000", -1000.0),
        ("G2 X10 I5 P1000", -999.5),
    ],
)
def test_p_counts_the_turns_that_are_begun(line: str, turns: float) -> None:
    """LinuxCNC, "G2, G3": P counts the turns, of which a part is one."""
    assert turns_of(line) == pytest.approx(turns, abs=1e-12)


@pytest.mark.parametrize("p", ["0", "-1", "1.5", "1001", "1000000"])
def test_other_numbers_of_turns_are_refused(p: str) -> None:
    """A million turns would take hours of planning: it is a typing error."""
    with pytest.raises(GcodeError) as caught:
        turns_of(f"G2 I5 P{p}")
    assert (caught.value.diagnostic.code, caught.value.diagnostic.column) == (
        "value-out-of-range",
        7,
    )
    assert "from 1 to 1000" in caught.value.diagnostic.message
