"""Modes and parameters between entered lines."""

from __future__ import annotations

import math

import pytest

from cnc.operate.modal_memory import MOST_PARAMETERS, ModalMemory


def after(*lines):
    memory = ModalMemory()
    known = [memory.note(line) for line in lines]
    return memory, known


@pytest.mark.parametrize(
    ("lines", "kept"),
    [
        (["G91 G1 X2 F1200", "X1"], "G91 G1 F1200"),
        (["G91", "#1=5"], "G91"),
        (["G91", "#<way> = [#1 + 3]"], "G91"),
        (["G20", "G1 X#1 Y[2*[#2+1]] F100"], "G20 G1 F100"),
        (["F100 S500", "G1 X1 F#3"], "G1 S500"),
        (["F100 S500", "S[#1*2]"], "F100"),
        (["G90 (G91)", "X[G91]"], "G90"),
        (["G91", "#<g90> = 3"], "G91"),
        (["G21", "G1 X SIN[30] F90"], "G21 G1 F90"),
        (["G91 F90", "M30"], ""),
        (["G20 G43.1 Z.3", "G21"], "G20 G43.1 Z.3\nG21"),
        (["G90 T3 M06", "G43"], "M61 Q3\nG21 G43\nG90"),
        (["M61 Q2", "G44 H5", "M30"], ""),
        (["G43 H1", "G43.2 H2"], ""),
        (["G0", "G81 Z-1 R1 F9"], "F9"),
    ],
)
def test_plain_codes_are_kept_beside_expressions(lines, kept):
    memory, known = after(*lines)
    assert all(known)
    assert memory.before("X1") == kept


@pytest.mark.parametrize(
    "line",
    [
        "G#1 X1",
        "G[90+1]",
        "M[3]",
        "M98 P100",
        "O<probe_z> call [1]",
        "G65 P9 A1",
        "X[1",
        "G43 H#1",
        "T#2 M6",
    ],
)
def test_modes_are_forgotten_after_codes_that_are_not_known(line):
    memory, known = after("G91 F100", line)
    assert known == [True, False]
    assert memory.before("X1") == ""


def test_a_dialect_without_m61_keeps_no_tool():
    memory = ModalMemory(has_m61=False)
    memory.note("T3 M6 G43 H3")
    assert memory.modes == "G21 G43 H3"


def test_parameters_are_assigned_before_the_next_line():
    memory, _ = after("G91")
    assert memory.note_parameters({1: 5.0, 101: -0.125, 5061: 3.0, 7: math.nan})
    assert memory.before("X#1").splitlines() == ["#1=5.000000000000", "#101=-0.125000000000", "G91"]
    assert not memory.note_parameters(dict.fromkeys(range(31, 32 + MOST_PARAMETERS), 1.0))
    assert memory.before("X#1") == "G91"
