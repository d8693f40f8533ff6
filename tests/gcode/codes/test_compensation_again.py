"""G41 and G42 while the compensation is on, by dialect."""

from __future__ import annotations

import pytest

from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from tests.support.gcode.gcode_cases import block_summaries, end_of, error_of

AGAIN = "G21 G90 G17\nG0 X0. Y0.\nG41 D2\nG1 F60 X20.\n{}X40.\nY30.\nG40 X50.\nM30"


def tools() -> ToolTable:
    return ToolTable([ToolEntry(2, diameter=4.0), ToolEntry(3, diameter=-0.2)])


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_g41_again_with_the_same_radius_has_no_effect(dialect: str) -> None:
    def blocks(code: str) -> list[str]:
        return block_summaries(AGAIN.format(code), dialect=dialect, tools=tools())

    assert blocks("G41 ") == blocks("G41 D2 ") == blocks("")


@pytest.mark.parametrize(
    ("dialect", "code"),
    [("fanuc", "G42 "), ("fanuc", "G41 D3 "), ("linuxcnc", "G41 D2 "), ("auto", "G41 D2 ")],
)
def test_other_compensation_under_compensation_is_refused(dialect: str, code: str) -> None:
    found = error_of(AGAIN.format(code), dialect=dialect, tools=tools())
    assert (found.code, found.line) == ("compensation-already-on", 5)


def test_sinumerik_leads_in_again() -> None:
    """With a radius of 0 there is no way in."""
    source = "G17 G90 F60\nG0 X0 Y0\n{}G41 G1 X20\nG41 X40\nY30\nG40 X50"
    assert end_of(source.format(""), dialect="siemens") == [50.0, 30.0, 0.0]
    found = error_of(source.format("T2 D1\nM6\n"), dialect="siemens", tools=tools())
    assert found.code == "compensation-already-on"
