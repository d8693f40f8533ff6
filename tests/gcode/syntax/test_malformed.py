"""Malformed programs with the code, line and column of their errors.

The mark ¦ stands before the faulty part. It is removed before the program is run.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from cnc import gcode
from cnc.gcode.core.call_stack import Limits
from cnc.gcode.core.compensation import MAX_WAITING
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.reader.parser import MAX_LINE
from tests.support.gcode.gcode_cases import assert_error_at, error_of
from tests.support.paths import GCODE

FANUC = "G06.2 P2 K0 X0 Y0 F60\n"
PAPER = "G06.2 K1 U0 X0 Y0 F60\n"

CASES: dict[str, tuple[str, str]] = {
    # the text of a line
    "letter alone": ("number-missing", "G0 ¦X"),
    "letter before letter": ("number-missing", "G0 ¦X Y1"),
    "letter before comment": ("number-missing", "G0 ¦X (ten)"),
    "sign alone": ("number-missing", "G0 ¦X-"),
    "point alone": ("number-missing", "G0 ¦X."),
    "word in prose": ("number-missing", "G0 X1\n¦move to 5"),
    "two signs": ("number-malformed", "G0 ¦X--1"),
    "two points": ("number-malformed", "G0 X1.5¦.2"),
    "sum": ("number-malformed", "G0 X1¦-2"),
    "blank and sign": ("number-malformed", "G0 X 1 ¦+ 2"),
    "number alone": ("letter-missing", "¦5"),
    "number after comment": ("letter-missing", "G0 (a) ¦5"),
    "comma": ("character-unknown", "G0 X1¦,5"),
    "letter of another alphabet": ("character-unknown", "G0 ¦\u0425 1"),
    "digit of another alphabet": ("character-unknown", "G0 X¦\u0663"),
    "long s is no S": ("character-unknown", "¦\u017f100 M3"),
    "question mark": ("character-unknown", "X1 ¦?"),
    "checksum": ("line-checksum", "G0 X1¦*71"),
    "exponent": ("word-unused", "G0 X1¦E5"),
    "subprogram": ("sub-not-closed", "¦o100 sub"),
    "named subprogram": ("sub-unknown", "¦O<drill> call"),
    "code in a nested comment": ("comment-nested", "(a ¦(b) G1 X1)"),
    "code in a nested comment before ;": ("comment-nested", "(a ¦(b) G1 X1; (c))"),
    "code behind the last %": ("percent-place", "%\nG0 X1\n¦%\n(end)\nG0 X2"),
    "code behind a % with text": ("percent-place", "%\nG0 X1\n¦% LED on\nM3 S1"),
    "closing only": ("comment-not-open", "G0 X1 ¦) Y2"),
    "block delete twice": ("block-delete-place", "/¦/G0"),
    "percent after a word": ("percent-place", "G0 X1 ¦%"),
    "percent before more lines": ("percent-place", "G0 X1\n¦%\nG0 X2"),
    "NUL": ("control-character", "G0 ¦\0X1"),
    "a lost sector": ("zero-bytes", "G0 X1¦" + "\0" * 512),
    "escape in a comment": ("control-character", "G0 X1 (¦\x1b[1m)"),
    "carriage return inside": ("control-character", "G0 X1¦\rG0 X2"),
    "line too long": ("line-too-long", "G0 X1\n" + ";" * MAX_LINE + "¦;"),
    "number of four hundred digits": ("number-too-large", "G0 ¦X" + "9" * 400),
    "absurd number": ("number-too-large", "G0 ¦X-1000000001"),
    "absurd line number": ("number-too-large", "¦N99999999999"),
    # line numbers
    "line number in the middle": ("line-number-place", "G0 ¦N5 X1"),
    "two line numbers": ("line-number-place", "N1 ¦N2"),
    "negative line number": ("line-number-bad", "¦N-1"),
    # codes
    "unknown G": ("code-unknown", "G0 X1\n¦G123"),
    "G with hundredths": ("code-unknown", "¦G2.05"),
    "negative G": ("code-unknown", "¦G-1"),
    "minus zero": ("code-unknown", "¦M-0"),
    "unknown M": ("code-unknown", "¦M999"),
    "fractional M": ("code-unknown", "¦M3.5"),
    "tool length offset": ("tool-table-missing", "T1 M6\nG43 ¦H1"),
    "cutter compensation": ("tool-table-missing", "G41 ¦D1"),
    "cycle under another distance mode": (
        "cycle-distance-mode",
        "G81 X1 Z-1 R1 F9\nG91 ¦X2",
    ),
    "back boring cycle": ("code-not-supported", "¦G87 X1 R1 F10"),
    "blocks without end after a compensated move": (
        "compensation-look-ahead",
        "F60\nG41.1 D6\nG1 X10\n¦X20" + "\nG4 P0" * (MAX_WAITING + 1),
    ),
    # modal groups and words
    "two motions": ("modal-conflict", "G0 ¦G1 X1"),
    "two planes": ("modal-conflict", "G17 ¦G18"),
    "two units": ("modal-conflict", "G20 ¦G21"),
    "two distances": ("modal-conflict", "G90 ¦G91"),
    "two spindles": ("modal-conflict", "M3 S1 ¦M5"),
    "two coolants": ("modal-conflict", "M8 ¦M9"),
    "two stops": ("modal-conflict", "M0 ¦M30"),
    "cycle and cancel": ("modal-conflict", "G80 ¦G81 X1"),
    "dwell and machine coordinates": ("modal-conflict", "G4 P1 ¦G53 G0 X1"),
    "a word twice": ("word-repeated", "G0 X1 Y2 ¦X3"),
    "two feeds": ("word-repeated", "F1 ¦F2"),
    # words without a user
    "P without a user": ("word-unused", "G0 X1 ¦P2"),
    "I on a line": ("word-unused", "G1 F60 X1 ¦I2"),
    "the leftmost is named": ("word-unused", "G0 ¦R1 X1 Q2"),
    "K in the XY plane": ("word-unused", "G2 X10 I5 ¦K1 F60"),
    "J in the ZX plane": ("word-unused", "G18 G2 Z10 K5 ¦J1 F60"),
    "H alone": ("word-unused", "¦H1"),
    "D": ("word-unused", "G0 X1 ¦D1"),
    "L without G10": ("word-unused", "¦L2 P1"),
    "Q of a dwell": ("word-unused", "G4 P1 ¦Q2"),
    "offsets of an arc under G1": ("word-unused", "G1 F60\n¦I5"),
    "offsets of an arc after it was cancelled": ("word-unused", "G2 I5 F60\nG80\n¦I5"),
    "one P, two users": ("word-wanted-twice", "G4 ¦P1 G2 I5 F60"),
    "path and dwell": ("word-wanted-twice", "G64 ¦P1 G4"),
    # axis words
    "axis words after G80": ("motion-missing", "G2 I5 F60\nG80\n¦X2 Y1"),
    "axis words with G80": ("motion-missing", "G2 I5 F60\nG80 ¦X1"),
    "axis words with a dwell": ("axis-words-unused", "G0 X1\nG4 P1 ¦X2"),
    "axis words with G92.1": ("axis-words-unused", "G0 X1\nG92.1 ¦X2"),
    "two users of axis words": ("axis-words-wanted-twice", "G92 X1 ¦G0"),
    "G10 and a motion": ("axis-words-wanted-twice", "¦G1 G10 L2 P1 X1 F60"),
    "no such axis": ("axis-missing", "G0 X1 ¦A90"),
    "no such axis in G92": ("axis-missing", "G92 ¦C1"),
    "no such axis in G10": ("axis-missing", "G10 L2 P1 X1 ¦U2"),
    "no such axis along an arc": ("axis-missing", "G2 X10 I5 ¦B4 F60"),
    "G92 without axes": ("axis-words-missing", "¦G92"),
    "G53 with an arc": ("machine-coordinates-motion", "¦G53 G2 X1 I1 F60"),
    "G53 under an arc": ("machine-coordinates-motion", "G2 I1 F60\n¦G53 X1"),
    # feed, speed, tool, time
    "no feed": ("feed-missing", "G0 X1\n¦G1 X2"),
    "no feed, modal": ("feed-missing", "G1\n¦X2"),
    "no feed of an arc": ("feed-missing", "¦G3 I5"),
    "no feed under G93": ("feed-missing", "F60\nG93 G1 X1 F1\n¦X2"),
    "no feed after G93": ("feed-missing", "G93 G1 X1 F1\nG94\n¦X2"),
    "zero feed": ("feed-not-positive", "G1 X1 ¦F0"),
    "negative feed": ("feed-not-positive", "¦F-1"),
    "negative feed under G93": ("feed-not-positive", "G93 G1 X1 ¦F-1"),
    "next to no feed": ("feed-too-slow", "¦F0.00005"),
    "negative speed": ("value-out-of-range", "M3 ¦S-1"),
    "fractional tool": ("value-out-of-range", "¦T1.5"),
    "negative tool": ("value-out-of-range", "¦T-1"),
    "huge tool": ("value-out-of-range", "¦T100000"),
    "dwell without time": ("dwell-time-missing", "¦G4"),
    "negative dwell": ("value-out-of-range", "G4 ¦P-1"),
    "negative tolerance": ("value-out-of-range", "G64 ¦P-.1"),
    "negative tolerance of Q": ("value-out-of-range", "G64 P1 ¦Q-.1"),
    # offsets
    "G10 without L": ("offset-kind-missing", "¦G10 P1 X1"),
    "G10 of tools": ("tool-table-missing", "G10 L1 ¦P1 Z1"),
    "G10 with half an L": ("code-not-supported", "G10 ¦L2.5 P1 Z1"),
    "G10 without P": ("offset-system-missing", "¦G10 L2 X1"),
    "G10 of a tenth system": ("value-out-of-range", "G10 L2 ¦P10 X1"),
    "G10 of half a system": ("value-out-of-range", "G10 L2 ¦P1.5 X1"),
    "G10 without axes": ("axis-words-missing", "¦G10 L20 P1"),
    # arcs
    "arc of nothing": ("arc-center-missing", "G0 X1\n¦G2 X5 F60"),
    "arc of nothing, modal": ("arc-center-missing", "G2 I5 F60\n¦X5"),
    "arc alone": ("arc-center-missing", "¦G2 F60"),
    "half an absolute centre": ("arc-center-missing", "G90.1 ¦G2 X10 I5 F60"),
    "R and a centre": ("arc-radius-and-center", "G2 X10 I5 ¦R5 F60"),
    "centre after R": ("arc-radius-and-center", "G2 X10 R5 ¦J5 F60"),
    "centre at the start": ("arc-radius-zero", "G2 X10 ¦I0 F60"),
    "centre at the end": ("arc-radius-zero", "G2 X5 ¦I5 F60"),
    "R of nothing": ("arc-radius-zero", "G2 X5 ¦R0 F60"),
    "not on the circle": ("arc-radius-mismatch", "G0 X1\nG2 X10 Y0 ¦I5 J1.5 F60"),
    "R to where it starts": ("arc-radius-no-chord", "G2 X0 Y0 ¦R5 F60"),
    "R too small": ("arc-radius-too-small", "G2 X10 ¦R4 F60"),
    "half a turn of P": ("value-out-of-range", "G2 I5 ¦P1.5 F60"),
    "turns without end": ("value-out-of-range", "G2 I5 ¦P1000001 F60"),
    "no turn at all": ("value-out-of-range", "G2 I5 ¦P0 F60"),
    # NURBS, FANUC's form
    "1002 knot missing": ("fanuc-1002", FANUC + "K0 X1\n¦X2"),
    "1004 too few knots, point": ("fanuc-1004", FANUC + "K0 X1\nK1\nK1 ¦X2"),
    "1004 too few knots, motion": ("fanuc-1004", FANUC + "K0 X1\nK1\n¦G0 X2"),
    "1004 too few knots, end of program": ("fanuc-1004", FANUC + "K0 X1\nK1\n¦M30"),
    "1004 too few knots, end of file": ("fanuc-1004", "¦" + FANUC + "K0 X1\nK1"),
    "1005 left early": ("fanuc-1005", FANUC + "K0 X1\n¦G1 X2"),
    "1005 left early by percent": ("fanuc-1005", "%\n¦" + FANUC + "K0 X1\n%"),
    "1005 left early, end of file": ("fanuc-1005", "G0 X0\n¦" + FANUC + "K0 X1\n"),
    "1005 a NURBS inside": ("fanuc-1005", FANUC + "K0 X1\n¦" + FANUC),
    "1006 inverse time": ("fanuc-1006", "G93\n¦G06.2 P2 K0 X0 F60"),
    "1007 first knot too seldom": ("fanuc-1007", FANUC + "¦K1 X1\nK2\nK2"),
    "1007 first knot too often": ("fanuc-1007", FANUC + "K0 X1\n¦K0 X2\nK1\nK1"),
    "1007 last knot too seldom": ("fanuc-1007", FANUC + "K0 X1\n¦K1\nK2"),
    "1007 last knot too often": ("fanuc-1007", FANUC + "K0 X1\n¦K1 X2\nK1\nK1"),
    "1007 all the same": ("fanuc-1007", FANUC + "K0 X1\n¦K0\nK0"),
    "1008 inner knot": ("fanuc-1008", FANUC + "K0 X1\nK1 X2\nK1 X3\n¦K1 X4\nK2\nK2"),
    "1009 not the start": ("fanuc-1009", "G06.2 P2 K0 ¦X0.001 F60"),
    "1009 not the start, incremental": ("fanuc-1009", "G0 X5\nG91\nG06.2 P2 K0 ¦X5 F60"),
    "order too small": ("value-out-of-range", "G06.2 ¦P1 K0 X0 F60"),
    "order too large": ("value-out-of-range", "G06.2 ¦P11 K0 X0 F60"),
    "fractional order": ("value-out-of-range", "G06.2 ¦P2.5 K0 X0 F60"),
    # NURBS, the paper's form
    "first knot missing": ("nurbs-knot-missing", "¦G06.2 K1 X0 W1 F60"),
    "knot missing": ("nurbs-knot-missing", PAPER + "U0 X1\n¦X2"),
    "first point missing": ("nurbs-point-missing", "¦G06.2 K1 U0 F60"),
    "too few knots": ("nurbs-knots-too-few", PAPER + "U0 X1\nU1\nU1 ¦X2"),
    "left early": ("nurbs-left-early", PAPER + "U0 X1\n¦G0 X2"),
    "left early, M2": ("nurbs-left-early", PAPER + "U0 X1\n¦M2"),
    "inverse time": ("nurbs-wrong-mode", "G93\n¦G06.2 K1 U0 X0 F60"),
    "end multiplicity": ("nurbs-end-multiplicity", PAPER + "¦U1 X1\nU2\nU2"),
    "inner multiplicity": (
        "nurbs-inner-multiplicity",
        PAPER + "U0 X1\nU1 X2\nU1 X3\n¦U1 X4\nU2\nU2",
    ),
    "start point": ("nurbs-start-point", "G06.2 K1 U0 ¦X1 F60"),
    "degree too small": ("value-out-of-range", "G06.2 ¦K0 U0 X0 F60"),
    "degree too large": ("value-out-of-range", "G06.2 ¦K10 U0 X0 F60"),
    # NURBS, both
    "jump": ("nurbs-position-jump", FANUC + "K0 X1\nK1 X2\n¦K1 X3\nK2\nK2"),
    "words of both forms": ("nurbs-mixed-forms", "G06.2 K3 U0 X0 ¦R1 F60"),
    "P and W": ("nurbs-mixed-forms", "G06.2 P3 X0 ¦W1 F60"),
    "paper's words in FANUC's curve": ("nurbs-foreign-word", FANUC + "¦U0 X1"),
    "FANUC's words in the paper's curve": ("nurbs-foreign-word", PAPER + "U0 X1 ¦R1"),
    "knots decrease": ("nurbs-knots-decrease", PAPER + "U0 X1\nU1 X2\n¦U.5 X3"),
    "knots decrease at the end": ("nurbs-knots-decrease", PAPER + "U0 X1\nU1\n¦U.5"),
    "weight of nothing": ("nurbs-weight-not-positive", PAPER + "U0 X1 ¦W0"),
    "negative weight": ("nurbs-weight-not-positive", "G06.2 P2 K0 X0 ¦R-1 F60"),
    "weight without a point": ("nurbs-foreign-word", PAPER + "U0 X1\nU1 ¦W1"),
    "one control point": ("nurbs-one-point", PAPER + "¦U0"),
    "too few points": ("nurbs-too-few-points", "G06.2 K2 U0 X0 F60\nU0 X1\n¦U1"),
    "another axis": ("nurbs-mixed-axes", PAPER + "U0 X1 ¦Z1"),
    "another axis after a borrowed start": ("nurbs-mixed-axes", "G06.2 P2 F60\nK0 X1\nK1 ¦Y1"),
    "rotary axis": ("nurbs-mixed-axes", PAPER + "U0 X1 ¦A5"),
    "rotary axis in the first line": ("axis-missing", "G06.2 P2 K0 X0 ¦B5 F60"),
    "linear axis named like nothing here": ("nurbs-foreign-word", PAPER + "U0 X1 ¦V5"),
    "feed inside": ("nurbs-foreign-word", PAPER + "U0 X1 ¦F90"),
    "spindle inside": ("nurbs-foreign-word", PAPER + "U0 X1 ¦M3"),
    "mode inside": ("nurbs-foreign-word", PAPER + "¦G91 U0 X1"),
    "stop in the first line": ("nurbs-foreign-word", "G06.2 K1 U0 X0 F60 ¦M0"),
    "no use in the first line": ("word-unused", "G06.2 K1 U0 X0 ¦I5 F60"),
    "no feed of a curve": ("feed-missing", "¦G06.2 K1 U0 X0"),
    "one P, dwell and order": ("word-wanted-twice", "G4 ¦P2 G06.2 K0 X0 F60"),
    "axis words after the curve": ("nurbs-still-active", PAPER + "U0 X1\nU1\nU1\n¦X5"),
    "a knot too many": ("nurbs-still-active", FANUC + "K0 X1\nK1\nK1\n¦K1"),
    "a knot too many, paper": ("nurbs-still-active", PAPER + "U0 X1\nU1\nU1\n¦U1"),
}


TOOLS = (
    ToolEntry(1, 1, {"X": 0.5, "Z": 40.0}, 6.0),
    ToolEntry(2, 2, {"Z": 100.0}),
    ToolEntry(3, 3, {}, 4.0),
)


def _errors() -> Iterator[tuple[str, str, str, str]]:
    """Name, dialect, code and marked program of each case in the table above and errors.txt."""
    yield from ((name, "auto", code, marked) for name, (code, marked) in CASES.items())
    for number, line in enumerate(
        (GCODE / "errors.txt").read_text(encoding="utf-8").split("\n"), 1
    ):
        if number > 4 and (found := re.fullmatch(r"([a-z0-9-]+)(?: \[(\w+)\])?: (.*)", line)):
            yield (
                f"errors.txt {number} {found[1]}",
                found[2] or "auto",
                found[1],
                found[3].replace("\\n", "\n"),
            )


ERRORS = list(_errors())


@pytest.mark.parametrize(
    ("dialect", "code", "marked"),
    [error[1:] for error in ERRORS],
    ids=[error[0] for error in ERRORS],
)
def test_the_error_has_its_code_and_place(dialect: str, code: str, marked: str) -> None:
    tools = None if code == "tool-table-missing" else ToolTable(TOOLS)
    limits = Limits(repeated_lines=5000, depth=20)
    found = assert_error_at(
        code, marked, dialect=dialect, tools=tools, folders=[GCODE / "subroutines"], limits=limits
    )
    assert found.severity == "error"
    assert "token" not in found.message.lower()


NO_ERRORS = """
arc-distance before-each exact-path exact-stop feed-mode if-goto if-then input-output inverse-time
latin-1 macro-b non-modal pass-on per-minute per-revolution spindle-mode tool-change tool-length
utf-8 utf-8-sig while-do exact-stop-once figure-mirror figure-polar figure-rotation figure-scaling
not-needed s-goto s-if s-else s-endif s-while s-endwhile s-for s-endfor s-loop s-endloop s-repeat
s-call s-end s-proc s-holes s-turn s-again
s-until skip-alarm siemens-lathe
"""
"""Strings in the interpreter that look like an error code but are not."""
ELSEWHERE = """
abort-possible axis-idle code-not-needed code-skipped code-without-effect comment-mended
expression-too-deep
allowance-in-pocket allowance-sign decimal-point-needed lathe-dialect-unclear profile-empty
profile-line profile-missing profile-not-monotone profile-place profile-start profile-too-long
allowance-at-wall arc-without-center profile-beyond-start profile-return
thread-interrupted
thread-lead thread-start tool-word-form turning-plane face-code face-start mantle-words mantle-plane
tool-edge tool-width-missing undercut-size
comment-not-active not-gcode percent-code-behind percent-leader percent-unopened program-for-lathe
program-for-printer
cycle-not-compensated spindle-speed-assumed
tool-length-zero moves-not-checked tool-offset-assumed word-idle compensation-radius-zero
decimal-point-missing
dwell-long
dwell-short cycle-level-unclear offset-diameter offset-variable-wear
feed-before-units feed-in-mm s-def only-zero word-shadowed word-without-effect no-such-file
unreadable-file unwritable-file
unknown-dialect parameter-file-line parameter-file-order tool-repeated tool-table-malformed
tool-table-unreadable dwell-point machine-coordinates-absolute motion-assumed word-replaced
wrapped-axis-range tip-control-active in-turn program-ends-once second-coolant
rotary-axis-place optional-stop-off tool-direction singular-pose nurbs-rotary-axis nurbs-tip-rests
cycle-level-assumed retraction-left-out subprogram-missing control-variable probe-alarm
feed-assumed spindle-started tool-change-by-hand code-replaced main-program-later program-not-called
units-doubtful tool-offset-other tool-length-open offset-without-motion cycle-plane
"""
"""Warnings, and errors of files and names. They have their own tests."""


def test_every_error_code_has_a_program() -> None:
    """Each string that looks like an error code is the code of a program in the tables."""
    sources = [
        ast.parse(file.read_text(encoding="utf-8"))
        for file in Path(gcode.__file__).parent.rglob("*.py")
    ]
    texts = {
        node.value
        for tree in sources
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    codes = {text for text in texts if re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)+", text)}
    assert (
        codes - {code for _, _, code, _ in ERRORS} - {*NO_ERRORS.split(), *ELSEWHERE.split()}
        == set()
    )
    assert {*NO_ERRORS.split(), *ELSEWHERE.split()} <= codes


def test_the_table_has_enough_cases() -> None:
    assert len(ERRORS) >= 400


@pytest.mark.parametrize("plane", ["G17", "G18", "G19"])
def test_an_arc_needs_both_axes_of_its_plane(plane: str) -> None:
    axes = {"G17": ("x", "z"), "G18": ("x", "y"), "G19": ("x", "z")}[plane]
    found = error_of(f"{plane} G2 I1 F60", axes=axes)
    assert (found.code, found.column) == ("axis-missing", 5)


def test_a_rendered_error_marks_its_place() -> None:
    from cnc.gcode.core.program import interpret
    from cnc.gcode.reader.source_text import Text
    from cnc.model.diagnostics import GcodeError

    with pytest.raises(GcodeError) as caught:
        list(interpret(Text.of_lines(["G0 X1", "G1 Y2 I3 F60"], "part.nc")))
    assert str(caught.value).split("\n")[:3] == [
        "part.nc:2:7: word-unused: I3 has no use in this line",
        "  G1 Y2 I3 F60",
        "        ^~",
    ]


def test_an_error_in_a_called_file_names_that_file() -> None:
    found = error_of("G0 X1\no<broken> call\nG0 X2", folders=[GCODE / "subroutines"])
    assert (found.code, found.line, found.column, found.text) == (
        "word-unused",
        3,
        7,
        "G1 Y2 I3 F60",
    )
    assert Path(found.file) == GCODE / "subroutines" / "broken.ngc"


@pytest.mark.parametrize(
    ("dialect", "source"),
    [("auto", "o<deep> call [1]"), ("auto", "o<again> call"), ("fanuc", "N1 M98 P2001\nGOTO 1")],
)
def test_endless_programs_are_stopped(dialect: str, source: str) -> None:
    found = error_of(
        source,
        dialect=dialect,
        folders=[GCODE / "subroutines"],
        limits=Limits(repeated_lines=1000, depth=10),
    )
    assert found.code in ("call-too-deep", "loop-endless")
    assert found.line
    assert found.hint


@pytest.mark.parametrize(
    "value", ["1/0", "5 MOD 0", "SQRT[-1]", "LN[0]", "TAN[90]", "0**-1", "EXP[1000]", "ACOS[2]"]
)
def test_errors_of_undefined_values_have_hints(value: str) -> None:
    assert error_of(f"G0 X[{value}]").hint


@pytest.mark.parametrize("line", ["00001 ;", "00060 (PART 5) ;", " 00001"])
def test_a_zero_in_place_of_the_letter_of_a_program_number_is_named(line: str) -> None:
    found = error_of(f"%\n{line}\nG0 X1.\nM30\n%")
    assert (found.code, found.line) == ("letter-missing", 2)
    assert found.hint.endswith(f": O{line.strip()[1:5]}")
    assert "letter O" not in error_of("0001\nG0 X1").hint
