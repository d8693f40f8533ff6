"""Endless programs are found by a state that comes back, and honest long ones are not refused."""

from __future__ import annotations

import pytest

from cnc.gcode.core.call_stack import Limits
from cnc.gcode.core.modal_groups import ReadingPolicy
from tests.support.gcode.gcode_cases import error_of, run
from tests.support.soak import share

UNBOUNDED = Limits(repeated_lines=10**12)
"""With the limit of lines alone, these programs would take hours."""
ENDLESS = [
    ("fanuc", "O1\nN1 T1 M6\nT2 M6\nGOTO 1\nM30"),
    ("fanuc", "O1\nN1 G0 X1.\nX0.\nGOTO 1\nM30"),
    ("fanuc", "O1\n#1=5\nWHILE [#1 GT 2] DO1\nG0 X#1\nG0 X0.\nM8\nM9\nEND1\nM30"),
    ("fanuc", "O1\nN1 M98 P2\nGOTO 1\nM30\nO2\nG4 P10\nM99"),
    ("linuxcnc", "o1 while [1]\nG0 X1\nG0 X0\no1 endwhile\nM2"),
    ("linuxcnc", "o1 do\nG10 L2 P1 X1\nG10 L2 P1 X2\no1 while [1]\nM2"),
    ("siemens", "ANFANG:\nG0 X1\nG0 X0\nGOTOB ANFANG\nM30"),
    ("siemens", "LOOP\nM8\nM9\nENDLOOP\nM30"),
]


@pytest.mark.parametrize(("dialect", "source"), ENDLESS[:: share(1, 2)])
def test_a_state_that_comes_back_never_ends(dialect: str, source: str) -> None:
    found = error_of(source, dialect=dialect, limits=UNBOUNDED)
    assert found.code == "loop-endless"
    assert "changes any more" in found.message


@pytest.mark.parametrize(
    ("dialect", "source"),
    [
        ("fanuc", "O1\n#1=0\nN1 #1=#1+1\nG4 P10\nIF [#1 LT 6000] GOTO 1\nM30"),
        ("fanuc", "O1\nM98 P2 L9999\nM98 P2 L9999\nM30\nO2\nM8\nM9\nM99"),
        ("fanuc", "O1\nN1 G10 L11 P1 R0.001 G91\nG4 P1\nIF [#10001 LT 6.] GOTO 1\nM30"),
        ("fanuc", "O1\nN1 #3901=#3901+1\nG4 P1\nIF [#3901 LT 6000] GOTO 1\nM30"),
        ("linuxcnc", "o1 repeat [6000]\nM8\nM9\no1 endrepeat\nM2"),
        ("linuxcnc", "G91\no1 while [#5420 LT 6]\nG0 X0.001\nM8\nM9\no1 endwhile\nM2"),
        ("siemens", "ANFANG: M8\nM9\nENDLABEL:\nREPEAT ANFANG P=9999\nM30"),
        ("siemens", "R1=0\nWHILE R1<6000\nR1=R1+1\nM8\nM9\nENDWHILE\nM30"),
    ][:: share(1, 3)],
)
def test_a_long_program_ends(dialect: str, source: str) -> None:
    policy = ReadingPolicy(missing_programs="warn")
    run(source, dialect=dialect, limits=UNBOUNDED, policy=policy)


def test_a_loop_that_waits_for_an_input_is_not_certain_to_be_endless() -> None:
    source = "o1 do\nM66 P0 L0\nG4 P1\no1 while [#5399 EQ 0]\nM2"
    found = error_of(source, dialect="linuxcnc", limits=Limits(repeated_lines=30_000))
    assert "30 000 lines" in found.message
