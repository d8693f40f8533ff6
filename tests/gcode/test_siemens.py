"""SINUMERIK's own language: values, frames, jumps, branches and loops."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cnc.gcode.geometry.program_frame import ProgramFrame
from cnc.model.blocks import Polyline
from tests.support.gcode.gcode_cases import error_of, run


def points(source: str) -> list[tuple[float, ...]]:
    """The ends of the moves of a program, X Y Z."""
    return [
        tuple(row)
        for block in run(source, dialect="siemens")
        if isinstance(block, Polyline)
        for row in block.points.tolist()
    ]


@pytest.mark.parametrize(
    ("source", "ends"),
    [
        ("R1=2 R2=R1*3\nG0 X=R2 Y=IC(5)\nY=IC(5)", [(6, 5, 0), (6, 10, 0)]),
        ("G91 G0 X5\nX=AC(1) Y=IC(2)", [(5, 0, 0), (1, 2, 0)]),
        ("R1=0\nA1:\nR1=R1+1\nG0 X=R1\nIF R1<3 GOTOB A1", [(1, 0, 0), (2, 0, 0), (3, 0, 0)]),
        ("GOTOF END_\nG0 X9\nEND_: G0 X1", [(1, 0, 0)]),
        ("GOTO N30\nN20 G0 X9\nN30 G0 X1", [(1, 0, 0)]),
        ("GOTOF 30\nN20 G0 X9\nN030 G0 X1", [(1, 0, 0)]),
        ("R1=5\nIF R1==5\nG0 X1\nELSE\nG0 X2\nENDIF", [(1, 0, 0)]),
        ("R1=4\nIF R1==5\nG0 X1\nELSE\nG0 X2\nENDIF\nG0 Y1", [(2, 0, 0), (2, 1, 0)]),
        ("R1=4\nIF R1==5\nG0 X1\nENDIF\nG0 Y1", [(0, 1, 0)]),
        ("R3=1\nFOR R1=2 TO R3*4\nG0 X=R1\nENDFOR", [(2, 0, 0), (3, 0, 0), (4, 0, 0)]),
        ("FOR R1=2 TO 1\nG0 X=R1\nENDFOR\nG0 Y=R1", [(0, 2, 0)]),
        ("R1=3\nWHILE R1>1\nG0 X=R1\nR1=R1-1\nENDWHILE", [(3, 0, 0), (2, 0, 0)]),
        ("R1=0\nREPEAT\nR1=R1+1\nG0 X=R1\nUNTIL R1>=2", [(1, 0, 0), (2, 0, 0)]),
        ("LOOP\nG0 X1\nGOTOF OUT\nENDLOOP\nOUT: G0 X2", [(1, 0, 0), (2, 0, 0)]),
        (
            "FOR R1=1 TO 2\nFOR R2=1 TO 2\nG0 X=R1 Y=R2\nENDFOR\nENDFOR",
            [(1, 1, 0), (1, 2, 0), (2, 1, 0), (2, 2, 0)],
        ),
        ("TRANS X10 Y5\nG0 X1 Y1\nTRANS\nG0 X1 Y1", [(11, 6, 0), (1, 1, 0)]),
        ("TRANS X10\nROT Z90\nG0 X1 Y0", [(0, 1, 0)]),
        ("TRANS X10\nAROT RPL=90\nATRANS X1\nG0 X1 Y0", [(10, 2, 0)]),
        ("SCALE X2 Y2\nG0 X1 Y1 Z1\nMIRROR X0\nG0 X1 Y1", [(2, 2, 1), (-1, 1, 1)]),
        ("R1=30\nROT RPL=R1*3\nG0 X1 Y0", [(0, 1, 0)]),
        ("G700\nTRANS X1\nG0 X1", [(50.8, 0, 0)]),
    ],
)
def test_a_program_moves_to(source: str, ends: list[tuple[float, ...]]) -> None:
    assert points(f"{source}\nM30") == [pytest.approx(end, abs=1e-12) for end in ends]


@pytest.mark.parametrize(
    ("source", "code", "words"),
    [
        ("GOTOB A1\nA1: G0 X1", "jump-target-missing", "before this line"),
        ("A1: G0 X1\nGOTOF A1", "jump-target-missing", "after this line"),
        ("GOTOC A1", "code-not-supported", "a jump of this form"),
        ("IF R1==1\nG0 X1", "block-not-closed", "ENDIF"),
        ("ENDIF", "block-not-open", "ENDIF"),
        ("R1=1\nIF R1==1\nWHILE R1>2\nENDIF\nENDWHILE", "block-crossed", "line 3"),
        ("LOOP\nR1=1\nENDLOOP", "loop-endless", "LOOP"),
        ("ROT X30", "code-not-supported", "ROT about X or Y"),
        ("TRANS RPL=3", "code-not-supported", "RPL with TRANS"),
        ("SCALE X2 Y1\nAROT Z10", "code-not-supported", "different factors"),
        ("SCALE X0", "scaling-factor", "must not be 0"),
        ("POCKET3(1,2)", "code-not-supported", "rectangular pocket"),
        ("PROC FOO", "code-not-supported", "head of a subprogram"),
        ("G0 X\N{MINUS SIGN}1", "character-unknown", "U+2212"),
    ],
)
def test_a_fault_is_named(source: str, code: str, words: str) -> None:
    found = error_of(f"{source}\nM30", dialect="siemens")
    assert found.code == code
    assert words in f"{found.message} {found.hint}"


numbers = st.floats(-50.0, 50.0)
factors = st.sampled_from([-2.0, -1.0, 0.5, 1.0, 3.0])
steps = st.one_of(
    st.tuples(st.just("move"), numbers, numbers),
    st.tuples(st.just("turn"), st.floats(-360.0, 360.0), st.just(0.0)),
    st.tuples(st.just("scale"), factors, st.sampled_from([-1.0, 1.0])),
)


@given(st.lists(steps, max_size=6), numbers, numbers)
def test_frames_are_products_of_matrices(
    changes: list[tuple[str, float, float]], x: float, y: float
) -> None:
    """Each additive frame is a matrix that is applied before those already in effect."""
    frame, whole = ProgramFrame(), np.eye(3)
    for kind, a, b in changes:
        part = np.eye(3)
        if kind == "move":
            part[:2, 2] = a, b
            frame = frame.moved((a, b, 0.0))
        elif kind == "turn":
            cosine, sine = math.cos(math.radians(a)), math.sin(math.radians(a))
            part[:2, :2] = (cosine, -sine), (sine, cosine)
            turned = frame.turned((0, 1), a)
            assert turned is not None
            frame = turned
        else:
            part[0, 0], part[1, 1] = a, a * b
            frame = frame.scaled((a, a * b, 1.0))
        whole = whole @ part
    expected: NDArray[np.float64] = whole @ (x, y, 1.0)
    reached = frame.moved((x, y, 0.0)).shift
    size = 1.0 + float(np.abs(whole).max()) * 100.0
    assert reached[:2] == pytest.approx(expected[:2], abs=1e-12 * size)
