"""SINUMERIK's own language: values, frames, jumps, branches and loops."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cnc.gcode.core.call_stack import Limits
from cnc.gcode.core.coordinates import ProgramFrame
from cnc.model.blocks import NurbsFeed, Polyline
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.gcode_cases import block_summaries, error_of, run


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
        ("O1234\nG0 X1\nN5 O77\nY1", [(1, 0, 0), (1, 1, 0)]),
        ("GOTOF NEXT\nG0 X9\nNEXT: G0 X1", [(1, 0, 0)]),
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
        ("A1: G91 G0 X1\nREPEATB A1 P=2\nY1", [(1, 0, 0), (2, 0, 0), (3, 0, 0), (3, 1, 0)]),
        ("A1: G91 G0 X1\nY1\nREPEAT A1", [(1, 0, 0), (1, 1, 0), (2, 1, 0), (2, 2, 0)]),
        (
            "A1: G91 G0 X1\nENDLABEL: Y1\nZ1\nREPEAT A1\nX5",
            [(1, 0, 0), (1, 1, 0), (1, 1, 1), (2, 1, 1), (2, 2, 1), (7, 2, 1)],
        ),
        (
            "A1: G91 G0 X1\nB1: Y1\nZ1\nR1=2\nREPEAT A1 B1 P=R1\nX5",
            [
                (1, 0, 0),
                (1, 1, 0),
                (1, 1, 1),
                (2, 1, 1),
                (2, 2, 1),
                (3, 2, 1),
                (3, 3, 1),
                (8, 3, 1),
            ],
        ),
        (
            "G91 G0\nREPEAT A1 B1\nGOTOF END_\nA1: X1\nB1: Y1\nX9\nEND_: Z1",
            [(1, 0, 0), (1, 1, 0), (1, 1, 1)],
        ),
        (
            "G91 G0\nGOTOF BB\nAA: X1\nGOTOF CC\nBB: Y1\nREPEATB AA\nREPEATB BB\nCC: Z1",
            [(0, 1, 0), (1, 1, 0), (1, 2, 0), (1, 2, 1)],
        ),
        (
            "G91 G0\nOUT:\nINN: X1\nREPEATB INN P2\nY1\nREPEAT OUT",
            [
                (1, 0, 0),
                (2, 0, 0),
                (3, 0, 0),
                (3, 1, 0),
                (4, 1, 0),
                (5, 1, 0),
                (6, 1, 0),
                (6, 2, 0),
            ],
        ),
        (
            "G91 G0\nA1: X1\nL10\nREPEAT A1\nM30\n%_N_L10_SPF\nY1\nM17",
            [(1, 0, 0), (1, 1, 0), (2, 1, 0), (2, 2, 0)],
        ),
        (
            "G91 G0 R1=0\nA1: X1\nR1=R1+1\nIF R1==2 GOTOF OUT\nREPEAT A1 P=5\n"
            "OUT: Y1\nR1=9\nREPEATB OUT",
            [(1, 0, 0), (2, 0, 0), (2, 1, 0), (2, 2, 0)],
        ),
        ("TRANS X10 Y5\nG0 X1 Y1\nTRANS\nG0 X1 Y1", [(11, 6, 0), (1, 1, 0)]),
        ("TRANS X10\nROT Z90\nG0 X1 Y0", [(0, 1, 0)]),
        ("TRANS X10\nAROT RPL=90\nATRANS X1\nG0 X1 Y0", [(10, 2, 0)]),
        (  # the example of the manual, "Axial work offset (G58, G59)"
            "G0 X0 Y0 Z0\nTRANS X10 Y10 Z10\nATRANS X5 Y5\nX0 Y0 Z0\nN70 G58 X20\nX0 Y0 Z0\n"
            "G59 X10 Y10\nX0 Y0 Z0",
            [(0, 0, 0), (15, 15, 10), (25, 15, 10), (30, 20, 10)],
        ),
        ("R1=3\nG59 X=R1*2\nG58 X=R1 Y1\nG0 X1 Y1\nTRANS\nX1 Y1", [(10, 2, 0), (1, 1, 0)]),
        ("G700\nG59 X1\nROT RPL=90\nG58 Y1\nG0 X1 Y0", [(0, 50.8, 0)]),
        ("TRANS X10\nAROT RPL=90\nATRANS X1\nG59 X2\nG0 X1 Y0", [(12, 2, 0)]),
        ("SCALE X2 Y2\nG0 X1 Y1 Z1\nMIRROR X0\nG0 X1 Y1", [(2, 2, 1), (-1, 1, 1)]),
        ("R1=30\nROT RPL=R1*3\nG0 X1 Y0", [(0, 1, 0)]),
        ("G700\nTRANS X1\nG0 X1", [(50.8, 0, 0)]),
        (
            "EXTERN GO_(REAL)\nGO_(3)\nM30\n%_N_GO__SPF\nPROC GO_(REAL XX)\nG0 X=XX\nRET",
            [(3, 0, 0)],
        ),
        (
            "MOVE_\nG0 Y1\nM30\n%_N_MOVE__SPF\nPROC MOVE_\nG0 X3\nENDPROC",
            [(3, 0, 0), (3, 1, 0)],
        ),
    ],
)
def test_a_program_moves_to(source: str, ends: list[tuple[float, ...]]) -> None:
    assert points(f"{source}\nM30") == [pytest.approx(end, abs=1e-12) for end in ends]


@pytest.mark.parametrize(
    ("source", "code", "words"),
    [
        ("GOTOB A1\nA1: G0 X1", "jump-target-missing", "before this line"),
        ("A1: G0 X1\nGOTOF A1", "jump-target-missing", "after this line"),
        ("REPEATB A1", "jump-target-missing", "A1:"),
        ("A1: G0 X1\nREPEAT A1 P=0", "call-repeats", "P=0"),
        ("REPEAT A1\nG0 X2\nA1: G0 X1", "jump-target-missing", "ENDLABEL"),
        ("R1=2\nA1: G0 X1\nIF R1==3\nM30\nENDIF\nREPEAT A1", "code-not-supported", "line 4"),
        ("REPEAT A1 B1 C1", "code-not-supported", "REPEAT FIRST LAST"),
        ("G0 X1 LOOP", "code-not-supported", "LOOP"),
        ("G0 X1 GOTOF A1", "control-not-alone", "another line"),
        ("G0 X1 (MSG, hi)", "code-not-supported", "comment"),
        ("GOTOC A1", "code-not-supported", "a jump of this form"),
        ("IF R1==1\nG0 X1", "block-not-closed", "ENDIF"),
        ("ENDIF", "block-not-open", "ENDIF"),
        ("R1=1\nIF R1==1\nWHILE R1>2\nENDIF\nENDWHILE", "block-crossed", "line 3"),
        ("LOOP\nR1=1\nENDLOOP", "loop-endless", "LOOP"),
        ("ROT X30", "code-not-supported", "ROT about X or Y"),
        ("TRANS RPL=3", "code-not-supported", "RPL with TRANS"),
        ("G58", "code-not-supported", "G58 with X, Y or Z"),
        ("G59 X1 G0", "code-not-supported", "G59 with X, Y or Z in a line of its own"),
        ("G59 X1\nTRANS Y1", "code-not-supported", "G58 in place of TRANS"),
        ("G26 X100", "code-not-supported", "G26"),
        ("G26 S1000 M3", "code-not-supported", "G26"),
        ("G25 S-5", "value-out-of-range", "from 0 on"),
        ("SCALE X2 Y1\nAROT Z10", "code-not-supported", "different factors"),
        ("SCALE X0", "scaling-factor", "must not be 0"),
        ("POCKET3(1,2)", "code-not-supported", "rectangular pocket"),
        ("ORICURVE", "code-not-supported", "second curve"),
        ("G1 X1 F60 LEAD=5", "code-not-supported", "lead angle"),
        ("G1 X1 F60 A2=5", "code-not-supported", "RPY angle"),
        ("G1 X1 F60 C6=1", "code-not-supported", "cone"),
        ("TOROT", "code-not-supported", "direction of the tool"),
        ("PROC FOO(AXIS A)", "code-not-supported", "PROC with these parameters"),
        ("PROC FOO SAVE", "code-not-supported", "PROC with SAVE"),
        ("G1 X1 F100 RNDM=2", "code-not-supported", "RNDM"),
        ("G0 X1 M17", "code-unknown", "M17"),
        ("G1 X=1 M17", "code-not-supported", "M17 beside other words"),
        ("G0 X\N{MINUS SIGN}1", "character-unknown", "U+2212"),
    ],
)
def test_a_fault_is_named(source: str, code: str, words: str) -> None:
    limits = Limits(repeated_lines=5000)
    found = error_of(f"{source}\nM30", dialect="siemens", limits=limits)
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
    reached = frame.moved((x, y, 0.0)).origin
    size = 1.0 + float(np.abs(whole).max()) * 100.0
    assert reached[:2] == pytest.approx(expected[:2], abs=1e-12 * size)


def summaries(source: str) -> list[str]:
    return block_summaries(f"{source}\nM30", dialect="siemens")[:-1]


SUBPROGRAMS = """%_N_MAIN_MPF
N10 G90 G0 X0 Y0
R1=5
L10 P2
POCKET_A
L11 P0
M30
%_N_L10_SPF
G91 G0 X=R1
G90
M17
%_N_X_SPF
N5 PROC POCKET_A
R1=R1+1
G0 Y=R1
RET
%_N_L11_SPF
G0 X99
RET"""


def test_subprograms_are_called_by_number_and_name() -> None:
    assert points(SUBPROGRAMS) == [(0, 0, 0), (5, 0, 0), (10, 0, 0), (10, 6, 0)]


@pytest.mark.parametrize(("call", "x"), [("L10 P2", 10), ("P3 L10", 15), ("L10 P2.0", 10)])
def test_p_is_the_number_of_calls(call: str, x: int) -> None:
    assert points(SUBPROGRAMS.replace("L10 P2\n", f"{call}\n"))[-1] == (x, 6, 0)


@pytest.mark.parametrize("call", ["L10 P2.5", "L10 P-1", "L10 P10000", "POCKET_A P1.5"])
def test_a_number_of_calls_that_is_not_whole_is_no_call(call: str) -> None:
    """ "Subprogram technique", program repetition: P is a whole number from 1 to 9999."""
    program = SUBPROGRAMS.replace("L10 P2\n", f"{call}\n")
    found = error_of(program, dialect="siemens")
    assert (found.code, found.line) == ("code-not-supported", 4)


def test_a_subprogram_may_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "l20.spf").write_text("G0 X7\nM17\n", encoding="utf-8")
    (tmp_path / "DRILL.SPF").write_text("%_N_DRILL_SPF\nG0 Y7\nRET\n", encoding="utf-8")
    blocks = run("L20\nDRILL\nM30", dialect="siemens", folders=[tmp_path])
    found = [
        row for block in blocks if isinstance(block, Polyline) for row in block.points.tolist()
    ]
    assert found == [[7, 0, 0], [7, 7, 0]]


def test_corners_and_angles() -> None:
    """RND is a radius, CHR the legs and CHF the length of a chamfer; ANG and AR are angles."""
    leg = 1.5 / math.sqrt(2.0)
    found = summaries("G1 F60 X10 RND=2\nY10 CHR=3\nX0 CHF=1.5\nY-5")
    assert found == [
        "line 8 0 0 F60", "arc xy 8 2 10 2 0 2 0.25 60", "line 10 7 0 F60", "line 7 10 0 F60",
        f"line {leg:.6g} 10 0 F60", f"line 0 {round(10 - leg, 6):g} 0 F60", "line 0 -5 0 F60",
    ]  # fmt: skip
    assert summaries("G1 F60 X10 ANG=45\nY20 ANG=90") == ["line 10 10 0 F60", "line 10 20 0 F60"]
    assert summaries("F60\nG2 X10 AR=180\nG2 X20 AR=90\nG3 X30 AR=270") == [
        "arc xy 5 0 10 0 0 5 -0.5 60",
        f"arc xy 15 -5 20 0 0 {math.sqrt(50.0):.6f} -0.25 60",
        f"arc xy 25 -5 30 0 0 {math.sqrt(50.0):.6f} 0.75 60",
    ]


def test_a_dwell_in_turns_of_the_spindle() -> None:
    assert summaries("S600 M3\nG4 S10\nG4 F2")[1:] == ["dwell 1", "dwell 2", "spindle off 0"]


@pytest.mark.parametrize(
    ("source", "ends", "feeds"),
    [
        ("G70 G1 X1 F10", [25.4], [10.0]),
        ("G700 G1 X1 F10", [25.4], [254.0]),
        ("G71 G1 X1 F10", [1.0], [10.0]),
        ("G700 G1 X1 F10\nG71 X5 F20", [25.4, 5.0], [254.0, 20.0]),
        ("G70\nG1 F10 X1\nX2\nX3 F20\nG700 X4 F1", [25.4, 50.8, 76.2, 101.6], [10, 10, 20, 25.4]),
        ("G70 G95 S1000 M3\nG1 X1 F.1", [25.4], [100.0]),
    ],
)
def test_g70_leaves_the_units_of_feeds(source: str, ends: list[float], feeds: list[float]) -> None:
    """G70 and G71 are for distances; G700 and G710 for feeds too."""
    moves = [
        block for block in run(f"{source}\nM30", dialect="siemens") if isinstance(block, Polyline)
    ]
    assert [row[0] for block in moves for row in block.points] == pytest.approx(ends)
    assert [60.0 * feed for block in moves for feed in block.feeds] == pytest.approx(feeds)


def test_a_feed_under_g70_is_reported_once() -> None:
    found: list[Diagnostic] = []
    run("G70 G1 X1 F10\nX2 F20\nM30", dialect="siemens", warn=found.append)
    assert [(each.code, each.line, each.severity) for each in found] == [
        ("feed-in-mm", 1, "warning")
    ]
    found.clear()
    run("G71 G1 X1 F10\nG700 X2 F20\nM30", dialect="siemens", warn=found.append)
    assert not found
    thread = "G70\nCYCLE84(10,0,2,-5,,0,5,,1,0,100,100)"
    assert error_of(thread, dialect="siemens").code == "code-not-supported"


def test_variables_of_the_main_program() -> None:
    source = (
        "DEF REAL _Tol, _home=-5\nDEF INT _n\n_tol=.5 _N=2\nCYCLE832(_Tol,0,1)\n"
        "G0 X=_tol*_n+1 Y=_HOME\nIF _n==2 GOTOF OUT\nX9\nOUT: G0 Z=-_n"
    )
    assert points(f"{source}\nM30") == [(2, -5, 0), (2, -5, -2)]


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("OFFN=0.5", "only OFFN=0"),
        ("KONT", "NORM"),
        ('CYCLE800(0,"TC",0,57,0,0,0,0,-15,0,0,0,0,1)', "CYCLE800()"),
        ('CYCLE800(0,"TC",0,57,0,0,5,0,0,0,0,0,0,1)', "CYCLE800()"),
        ("POCKET3(1,2)", "CAM system"),
        ("CYCLE840(1,2)", "CYCLE84"),
        ("DEF STRING[8] _NAME", "DEF REAL"),
        ('WARMUP("SPINDLE", 5)', "R parameters"),
    ],
)
def test_words_that_change_the_path_are_refused_by_name(line: str, said: str) -> None:
    found = error_of(f"G0 X1\n{line}", dialect="siemens")
    assert (found.code, found.line) == ("code-not-supported", 2)
    assert said in found.hint


def test_the_end_of_a_swivelled_plane_has_no_effect() -> None:
    assert points("CYCLE800()\nOFFN=0\nG0 X1\nM30") == [(1, 0, 0)]
    assert error_of("TRANS X1\nCYCLE800()", dialect="siemens").code == "code-not-supported"
    assert points("TRANS X1\nTRANS\nCYCLE800()\nG0 X1\nM30") == [(1, 0, 0)]


@pytest.mark.parametrize(("retract", "codes"), [("0", []), ("1", ["retraction-left-out"])])
def test_a_plane_without_angles_and_shifts_has_no_effect(retract: str, codes: list[str]) -> None:
    """CAM systems write all arguments; without angles and shifts the plane is that before."""
    found: list[Diagnostic] = []
    line = f'CYCLE800({retract},"TC1",200000,57,0,0,0,0,0,0,0,0,0,-1,100,1)'
    program = f"G0 X1\n{line}\nG0 X2\nM30"
    assert points(program) == [(1, 0, 0), (2, 0, 0)]
    run(program, dialect="siemens", warn=found.append)
    assert [each.code for each in found if each.severity == "warning"] == codes


def test_a_plane_that_may_turn_axes_back_is_refused() -> None:
    program = 'G0 A30\nCYCLE800(0,"TC1",0,57,0,0,0,0,0,0,0,0,0,-1)'
    assert error_of(program, dialect="siemens", axes="xyza").code == "code-not-supported"


def test_splines_have_the_words_of_rs274() -> None:
    """The dialect reads BSPLINE, SD=, PL= and PW= as ``auto`` does, with expressions too."""
    program = "G1 F60 X0\nBSPLINE SD=2\nX1 Y2\nX3 Y1 PW={weight} PL=1.5\nX5\nG1 X6\nM30"
    own = run(program.format(weight="2*2"), dialect="siemens")
    other = run(program.format(weight="4"), dialect="auto")
    curves = [next(b for b in blocks if isinstance(b, NurbsFeed)) for blocks in (own, other)]
    assert (curves[0].knots == curves[1].knots).all()
    assert (curves[0].weights == [1.0, 1.0, 4.0, 1.0]).all()
    assert (curves[0].control_points == curves[1].control_points).all()
