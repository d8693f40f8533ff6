"""P of pecking cycles: a dwell of Haas, stored data of FANUC, and an error of LinuxCNC."""

from __future__ import annotations

import pytest

from cnc.model.blocks import Dwell
from tests.support.gcode.gcode_cases import block_summaries, error_of, points, run, warnings
from tests.support.gcode.turning_cases import lathe_blocks

HEAD = "G21\nS100 M3\nG0 Z5.\n"


@pytest.mark.parametrize("cycle", ["G73", "G83"])
def test_haas_dwells_at_the_bottom_of_each_hole(cycle: str) -> None:
    """The P of the first line stays, and is in seconds with a decimal point."""
    program = f"{HEAD}G99 {cycle} X1. Z-2. R1. Q2. P0.5 F60.\nX2.\nG80\nM30"
    found = block_summaries(program, dialect="haas")
    dwells = [at for at, block in enumerate(found) if block.startswith("dwell")]
    assert [found[at] for at in dwells] == ["dwell 0.5"] * 2
    assert [found[at - 1] for at in dwells] == ["line 1 0 -2 F60", "line 2 0 -2 F60"]
    assert [found[at + 1] for at in dwells] == ["rapid 1 0 1", "rapid 2 0 1"]


def test_fanuc_stores_a_dwell_for_later_cycles() -> None:
    program = f"{HEAD}G99 G83 X1. Z-1. R1. Q9. P500 F60.\nX2.\nG82 X3.\nG80\nM30"
    dwells = [block.seconds for block in run(program, dialect="fanuc") if isinstance(block, Dwell)]
    assert dwells == [0.5]
    said = [each for each in warnings(program, "fanuc") if each.code == "word-idle"]
    assert [each.line for each in said] == [4]
    without = program.replace(" P500", "").replace("G82", "G82 P500")
    assert points(program, "fanuc") == points(without, "fanuc")


@pytest.mark.parametrize("dialect", ["linuxcnc", "auto", "mach3"])
def test_p_of_g83_is_an_error_elsewhere(dialect: str) -> None:
    program = f"{HEAD}G99 G83 X1. Z-2. R1. Q1. P0.5 F60.\nM30"
    assert error_of(program, dialect=dialect).code == "word-unused"


@pytest.mark.parametrize(("word", "dwells"), [("", []), (" P500", [0.5])])
def test_a_peck_cycle_of_a_lathe_dwells_at_the_bottom(word: str, dwells: list[float]) -> None:
    program = f"G98 G0 X0 Z5.\nG97 S500 M3\nG83 Z-10. R1. Q4000 F60.{word}\nG80\nM30"
    found = lathe_blocks(program)
    assert [block.seconds for block in found if isinstance(block, Dwell)] == dwells
