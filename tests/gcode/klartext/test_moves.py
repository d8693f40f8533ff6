"""Moves of Klartext, with blocks that were computed by hand from Heidenhain's manual."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from cnc.model.blocks import ArcFeed, NurbsFeed, Polyline
from tests.gcode.program.test_compiled_lines_in_programs import agree
from tests.support.gcode.gcode_cases import assert_blocks, block_summaries, error_of, run, warnings
from tests.support.soak import share


def summaries(source: str) -> list[str]:
    """The blocks of a program behind its BEGIN PGM."""
    return block_summaries(f"BEGIN PGM A MM\n{source}\nEND PGM A MM", dialect="heidenhain")[:-1]


MOVES = {
    # absolute and incremental words, modal feed; FMAX holds for its block only
    "L X+10 Y-5 F200\nL IX+2.5 Z+1 FMAX\nL IY-1": [
        "line 10 -5 0 F200", "rapid 12.5 -5 1", "line 12.5 -6 1 F200",
    ],
    "TOOL CALL S800 F300\nL X1 F AUTO\nL X2 F50\nL X3 FAUTO": [
        "line 1 0 0 F300", "line 2 0 0 F50", "line 3 0 0 F300",
    ],
    # without a feed of its own a move takes that of TOOL CALL
    "TOOL CALL F300\nL Y1 FMAX\nL X1\nL X2 F50\nL X3": [
        "rapid 0 1 0", "line 1 1 0 F300", "line 2 1 0 F50", "line 3 1 0 F50",
    ],
    # TNC 640, "Circle C around circle center CC"
    "CC X+25 Y+25\nL X+45 Y+25 FMAX\nC X+45 Y+25 DR+ F100": [
        "rapid 45 25 0", "arc xy 25 25 45 25 0 20 1 100",
    ],
    "L X+1 F9\nCC IX+2 IY+0\nC X+5 Y+0 DR-": ["line 1 0 0 F9", "arc xy 3 0 5 0 0 2 -0.5 9"],
    "L X+1 Y+1 F9\nCC\nL X+2\nC X+1 Y+2 DR+": [
        "line 1 1 0 F9", "line 2 1 0 F9", "arc xy 1 1 1 2 0 1 0.25 9",
    ],
    "L X+1 F9\nCC X+0 Y+0\nC X+0 Y+1 IZ-4 DR+": ["line 1 0 0 F9", "arc xy 0 0 0 1 -4 1 0.25 9"],
    # TNC 640, "Circle CR with fixed radius": R- is more than half a turn
    "L X+40 Y+40 FMAX\nCR X+70 Y+40 R+20 DR- F8": [
        "rapid 40 40 0", "arc xy 55 26.771243 70 40 0 20 -0.269947 8",
    ],
    "L X+40 Y+40 FMAX\nCR X+70 Y+40 R-20 DR+ F8": [
        "rapid 40 40 0", "arc xy 55 26.771243 70 40 0 20 0.730053 8",
    ],
    # a line along X, then an arc: its centre lies above the end of the line
    "L X+10 F50\nCT X+20 Y+10": ["line 10 0 0 F50", "arc xy 10 10 20 10 0 10 0.25 50"],
    "L X+10 F50\nCT X+20 Y-10\nCT X+30 Y-20": [
        "line 10 0 0 F50", "arc xy 10 -10 20 -10 0 10 -0.25 50",
        "arc xy 30 -10 30 -20 0 10 0.25 50",
    ],
    # the direction behind C and CR
    "L X+1 F9\nCC X+0 Y+0\nC X+0 Y+1 DR+\nCT X-2 Y+3": [
        "line 1 0 0 F9", "arc xy 0 0 0 1 0 1 0.25 9", "arc xy 0 3 -2 3 0 2 -0.25 9",
    ],
    "CR X+0 Y+2 R-1 DR+ F9\nCT X-1 Y+3": [
        "arc xy 0 1 0 2 0 1 0.5 9", "arc xy 0 3 -1 3 0 1 -0.25 9",
    ],
    # TNC 640, "Straight line LP": the angle may be incremental, the radius stays
    "CC X+45 Y+25\nLP PR+30 PA+0 F300\nLP PA+60\nLP IPA+60\nLP PA+180 IPR-10": [
        "line 75 25 0 F300", "line 60 50.980762 0 F300", "line 30 50.980762 0 F300",
        "line 25 25 0 F300",
    ],
    # TNC 640, "Helix": five turns, and half a turn more than one
    "CC X+0 Y+0\nLP PR+3 PA+270 F50\nCP IPA-1800 IZ+5 DR-\nCP IPA+540 DR+": [
        "line 0 -3 0 F50", "arc xy 0 0 0 -3 5 3 -5 50", "arc xy 0 0 0 3 5 3 1.5 50",
    ],
    "CC X+0 Y+0\nL X+2 F5\nCP PA+90 DR+\nCP PA-180 DR+\nCP PA+180 DR-": [
        "line 2 0 0 F5", "arc xy 0 0 0 2 0 2 0.25 5", "arc xy 0 0 -2 0 0 2 0.25 5",
        "arc xy 0 0 -2 0 0 2 -1 5",
    ],
    # rounds and chamfers
    "L X+10 F60\nRND R3\nL Y+10": [
        "line 7 0 0 F60", "arc xy 7 3 10 3 0 3 0.25 60", "line 10 10 0 F60",
    ],
    "L X+10 F60\n;a comment\nCHF 3\nL Y+10": [
        "line 7 0 0 F60", "line 10 3 0 F60", "line 10 10 0 F60",
    ],
    # M functions at the start and at the end of a block
    "L X+1 F5 M13\nL X+2 M5 M9": [
        "spindle cw 100", "coolant false true", "line 1 0 0 F5", "line 2 0 0 F5",
        "spindle off 0", "coolant false false",
    ],
    "M3\nL M4\nSTOP M8": ["spindle cw 100", "spindle ccw 100", "coolant false true", "stop"],
    "L X+1 FMAX M0\nL X+2 M1 FMAX": [
        "rapid 1 0 0", "spindle off 0", "stop", "rapid 2 0 0", "optional-stop",
    ],
    "L X+1 FMAX M30\nL X+2 FMAX": ["rapid 1 0 0"],
}  # fmt: skip


@pytest.mark.parametrize("source", MOVES)
def test_moves(source: str) -> None:
    found, wanted = summaries(f"TOOL CALL S100\n{source}"), MOVES[source]
    assert found[: len(wanted)] == wanted
    assert {"spindle off 0", "coolant false false"}.issuperset(found[len(wanted) :])


def test_inches_and_feeds_in_tenths_of_an_inch() -> None:
    # F in tenths of an inch per minute
    assert_blocks(
        "BEGIN PGM A INCH\nL X+1 F100\nL IY-0.5\nEND PGM A INCH",
        ("line", 25.4, 0, 0, 254), ("line", 25.4, -12.7, 0, 254), ("end",),
        dialect="heidenhain",
    )  # fmt: skip


def test_lines_with_comments_numbers_and_structure() -> None:
    source = "  \n* - Contour\n12 ; text\n13 * - more\n14 L  X 1 Y -2 F 50 ; end\n\tl x+3 fmax"
    assert summaries(source) == ["line 1 -2 0 F50", "rapid 3 -2 0"]


def test_rotary_axes() -> None:
    source = "BEGIN PGM A MM\nL C+90 A-5 FMAX\nL IC+10 FMAX\nEND PGM A MM"
    found = block_summaries(source, axes=("x", "y", "z", "a", "c"), dialect="heidenhain")
    assert found == ["rapid 0 0 0 -5 90", "rapid 0 0 0 -5 100", "end"]


def test_machine_coordinates_ignore_the_length_and_the_shift() -> None:
    source = (
        "TOOL DEF 1 L+10 R+2\nTOOL CALL 1 Z S100\nCYCL DEF 7.0 DATUM SHIFT\nCYCL DEF 7.1 X+3\n"
        "L X+1 Z+1 FMAX\nL X+1 Z+1 FMAX M91"
    )
    assert summaries(source) == ["tool 1", "rapid 4 0 11", "rapid 1 0 1"]


def test_compensation_with_the_tool_of_tool_call() -> None:
    # the square of 10 mm, outside to the left, with a tool of 4 mm
    source = (
        "TOOL DEF 1 R+2\nTOOL CALL 1 Z S100\nL Y-10 FMAX\nL X+0 Y+0 RL F50\nL Y+10\nL X+10\n"
        "L Y+0\nL Y-10 R0"
    )
    assert summaries(source) == [
        "tool 1", "rapid 0 -10 0", "line -2 0 0 F50", "line -2 10 0 F50",
        "arc xy 0 10 0 12 0 2 -0.25 50", "line 10 12 0 F50", "arc xy 10 10 12 10 0 2 -0.25 50",
        "line 12 0 0 F50", "line 10 -10 0 F50",
    ]  # fmt: skip


def test_a_spline_runs_from_t_1_to_0() -> None:
    # X = 30 - 20 t - 10 t^3 and Y = 6 t^2 - 6 t, from (0, 0) to (30, 0)
    source = "SPL X+30 Y+0 K3X-10 K1X-20 K2Y+6 K1Y-6 F120"
    (spline, _) = run(f"BEGIN PGM A MM\n{source}\nEND PGM A MM", dialect="heidenhain")
    assert isinstance(spline, NurbsFeed)
    assert (spline.degree, spline.feed) == (3, 2.0)
    for t in np.linspace(0.0, 1.0, 11):
        u = 1.0 - t
        bernstein = [t**3, 3 * t * t * u, 3 * t * u * u, u**3]
        found = np.dot(bernstein, spline.control_points)
        wanted = (30 - 20 * t - 10 * t**3, 6 * t * t - 6 * t, 0.0)
        assert found == pytest.approx(wanted, abs=1e-12)


def test_an_arc_continues_a_spline() -> None:
    source = "SPL X+30 Y+0 K1X-30 F120\nCT X+40 Y+10"
    found = run(f"BEGIN PGM A MM\n{source}\nEND PGM A MM", dialect="heidenhain")
    assert isinstance(found[1], ArcFeed)
    assert found[1].center == pytest.approx((30.0, 10.0), abs=1e-12)


def test_a_polygon_by_polar_angles_closes() -> None:
    source = "FN 0: Q1 = +0\nCC X+10 Y+10\nLBL 1\nLP PR+5 PA+Q1 F90\nQ1 = Q1 + 360 / 7\n"
    source += "CALL LBL 1 REP 7"
    (run_of_moves, _) = run(f"BEGIN PGM A MM\n{source}\nEND PGM A MM", dialect="heidenhain")
    assert isinstance(run_of_moves, Polyline)
    angles = np.arange(8) * math.tau / 7
    wanted = np.column_stack([10 + 5 * np.cos(angles), 10 + 5 * np.sin(angles), 0 * angles])
    assert run_of_moves.points == pytest.approx(wanted, abs=1e-12)


ERRORS = {
    "C X+1 Y+1 DR+ F9": "arc-center-missing",
    "CC X+1 Y+0\nC X+2 Y+0 F9": "klartext-incomplete",
    "CC X+1 Y+0\nC X+2 Y+0.2 DR+ F9": "arc-radius-mismatch",
    "CC X+1\nC X+2 Y+0 DR+ F9": "code-not-supported",
    "CC X+1 Y+0\nC X+2 Y+0 DR+ FMAX": "code-not-supported",
    "CR X+9 Y+0 R+2 DR+ F9": "arc-radius-too-small",
    "CR X+0 Y+0 R+2 DR+ F9": "arc-radius-no-chord",
    "CT X+9 Y+1 F9": "arc-tangent-missing",
    "L X+1 F9\nCT X+2 Y+0": "arc-tangent-missing",
    "L Z+1 F9\nCT X+2 Y+2": "arc-tangent-missing",
    "CC X+1 Y+0\nCP IPA+90 DR- F9": "arc-angle",
    "CC\nCP IPA+90 DR+ F9": "polar-at-origin",
    "CC X+1 Y+0\nLP IPA+90 F9": "polar-at-origin",
    "CC X+1 Y+0\nL X+9 F9\nLP PA+90": "polar-at-origin",
    "LP PR+1 PA+90 F9": "arc-center-missing",
    "CC X+1 Y+0\nCYCL DEF 7.1 X+1\nLP PR+1 PA+90 F9": "arc-center-missing",
    "L X+1 X+2 F9": "word-repeated",
    "L X+1 IX+2 F9": "word-repeated",
    "L X+1 F9 FMAX": "word-repeated",
    "L X+1 RL RR F9": "word-repeated",
    "L X+1 DR+ F9": "klartext-word",
    "CT X+1 Y+1 Z+1 F9": "klartext-word",
    "L X+1": "feed-missing",
    "L X+1 F AUTO": "feed-missing",
    "L B+1 FMAX": "axis-missing",
    "L IB+1 FMAX": "axis-missing",
    "L IX+1 FMAX M91": "code-not-supported",
    "L X+1 FMAX M128": "code-not-supported",
    "L X+1 FMAX M140": "code-not-supported",
    "L X+1 FMAX\nRND R2\nL Y+1 F9": "corner-next",
    "L X+9 F9\nRND R2\nL Y+9 FMAX": "corner-next",
    "L X+9 F9\nRND R2 F5\nL Y+9": "corner-next",
    "L X+9 F9\nRND R20\nL Y+9": "corner-too-large",
    "RND R2": "corner-next",
    "SPL X+30 Y+0 K1X-20 F9": "nurbs-start",
    "SPL X+30 K1X-30 K1X+2 F9": "klartext-word",
    "SPL X+30 K1X-30": "feed-missing",
    "TOOL CALL 5 Y S100": "code-not-supported",
    'TOOL CALL "MILL" Z S100': "code-not-supported",
    "TOOL CALL 5 Z S100 DL+0.1": "code-not-supported",
    "BEGIN PGM B MM": "program-repeated",
}  # fmt: skip


@pytest.mark.parametrize("source", ERRORS)
def test_what_a_block_lacks(source: str) -> None:
    found = error_of(f"BEGIN PGM A MM\n{source}\nEND PGM A MM", dialect="heidenhain")
    assert found.code == ERRORS[source], found.render()
    assert found.line > 1
    assert found.column >= 1


def test_functions_without_effect_are_said() -> None:
    source = "BEGIN PGM A MM\nBLK FORM 0.1 Z X+0 Y+0 Z-9\nL X+1 FMAX M6 M127\nFN 15: PRINT 3"
    found = warnings(f"{source}\nEND PGM A MM", "heidenhain")
    assert [(each.code, each.line) for each in found] == [
        ("code-not-needed", 2), ("code-not-needed", 3), ("code-not-needed", 3),
        ("code-not-needed", 4),
    ]  # fmt: skip


def test_a_file_without_its_end_is_refused() -> None:
    assert (
        error_of("BEGIN PGM A MM\nL X+1 FMAX", dialect="heidenhain").code == "program-end-missing"
    )


_MOVES = (
    "L X{x} Y{y}", "L X{x} Y{y} Z{z} F{f}", "L Z{z} R0 FMAX", "L IX{x} Y{y}", "{n} L Y{y} ; a text",
    "L X{x} F AUTO", "L X{x} X{y}", "L X+Q1 Y{y}", "L X{x} Y{y} R0 F{f} M3", "L F{f}", "L X0 F0",
    "CC X{x} Y{y}", "C X{x} Y{y} DR+", "CT X{x} Y{y}", "RND R0.1", "CHF 0.1", "LP PR{f} PA{x}",
    "CR X{x} Y{y} R+500 DR-", "L X{x} Y{y} RL", "L X-0 A1", "Q1 = {x}", "L X{x} FMAX M91", "",
    "TOOL CALL 1 Z S{f} F{f}", "CYCL DEF 7.0", "CYCL DEF 7.1 X{x}", "CYCL DEF 8.0",
    "CYCL DEF 8.1 X", "CYCL DEF 10.0", "CYCL DEF 10.1 ROT{x}", "L X99999999999 Y1", "* - a part",
    "L X1234567890.123456789", "L X{x} M89", "LBL 1", "CALL LBL 1 REP 1", "L X{x} Y{y} FMAX F{f}",
)  # fmt: skip


def _random_program(rng: random.Random) -> list[str]:
    lines = [f"0 BEGIN PGM A {rng.choice(['MM', 'MM', 'INCH'])}"]
    lines += rng.choice([[], ["TOOL CALL 1 Z S100 F300"], ["L X1 Y1 Z1 F100"]])
    for _ in range(rng.randint(1, 40)):
        form = _MOVES[rng.choice([0, 1, 0, 1, 2, 4, rng.randrange(len(_MOVES))])]
        x, y, z = (f"{rng.choice('+-')}{rng.uniform(0, 20):.3f}" for _ in "xyz")
        lines.append(form.format(x=x, y=y, z=z, f=rng.randint(1, 900), n=len(lines)))
    return [*lines, "END PGM A MM"]


@pytest.mark.timeout(3600)
def test_moves_of_compiled_code_are_those_of_the_interpreter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for seed in range(share(20_000, 300)):
        program = _random_program(random.Random(seed))
        agree(monkeypatch, program, ("x", "y", "z"), "heidenhain", shortest=3)
