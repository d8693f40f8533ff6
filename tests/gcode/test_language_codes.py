"""Codes with expected blocks, which were worked out by hand.

The default machine has the axes x y z. Feeds in the expected rows are in mm/min.
"""

from __future__ import annotations

import numpy as np
import pytest

from cnc.model.blocks import Polyline
from tests.support.gcode.gcode_cases import assert_blocks, end_of, run

INCH = 25.4
XYZA = ("x", "y", "z", "a")

CASES = {
    # G0, G1, F
    "traverse": ("G0 X1 Y2 Z3", [("rapid", 1, 2, 3)]),
    "modal motion": ("G0 X1\nY2\nG1 Z-1 F60\nX0",
        [("rapid", 1, 0, 0), ("rapid", 1, 2, 0), ("line", 1, 2, -1, 60), ("line", 0, 2, -1, 60)]),
    "feed is modal": ("F100\nG1 X1\nF200 X2\nG0 X3 F300\nG1 X4", [
        ("line", 1, 0, 0, 100), ("line", 2, 0, 0, 200), ("rapid", 3, 0, 0),
            ("line", 4, 0, 0, 300)]),
    "motion code alone": ("G1 F50\nX1", [("line", 1, 0, 0, 50)]),
    "no move at all": ("G1 X0 F10", [("line", 0, 0, 0, 10)]),
    # spelling
    "any case and spacing": ("g 0 1 x+0 . 1 2 3 y - . 5\tf1 0 0", [("line", 0.123, -0.5, 0, 100)]),
    "words in any order": ("F100 Y2 G1 X1", [("line", 1, 2, 0, 100)]),
    "number forms": ("G0 X1. Y.5 Z+2.50", [("rapid", 1, 0.5, 2.5)]),
    "line numbers": ("N1 G0 X1\nN0005 X2\nn7", [("rapid", 1, 0, 0), ("rapid", 2, 0, 0)]),
    "comments": ("(a) G0 (b; c) X1 ; (d\n;e\n(f)", [("rapid", 1, 0, 0)]),
    "message": ("(MSG, hello there )\n( msg ,second)G0 X1\n(not msg, this)", [
        ("message", "hello there"), ("message", "second"), ("rapid", 1, 0, 0)]),
    "percent": ("\n(head)\n%\nG0 X1\n%\nnot read [", [("rapid", 1, 0, 0)]),
    "percent at the end only": ("G0 X1\n%\n\n", [("rapid", 1, 0, 0)]),
    "block delete off": ("/G0 X1", [("rapid", 1, 0, 0)]),
    "program number": ("%\nO1234 (PART)\nG0 X1\nM30\n%", [("rapid", 1, 0, 0), ("end",)]),
    # G2, G3 in the centre format
    "quarter counter-clockwise": ("G0 X10\nG3 X0 Y10 I-10 F60",
        [("rapid", 10, 0, 0), ("arc", "XY", 0, 0, 0, 10, 0, 10, 0.25, 60)]),
    "three quarters clockwise": ("G0 X10\nG2 X0 Y10 I-10 F60",
        [("rapid", 10, 0, 0), ("arc", "XY", 0, 0, 0, 10, 0, 10, -0.75, 60)]),
    "half circle": ("G2 X10 I5 F60", [("arc", "XY", 5, 0, 10, 0, 0, 5, -0.5, 60)]),
    "full circle": ("G2 I5 F60", [("arc", "XY", 5, 0, 0, 0, 0, 5, -1, 60)]),
    "full circle, end given": ("G3 X0 Y0 J-5 F60", [("arc", "XY", 0, -5, 0, 0, 0, 5, 1, 60)]),
    "full circle again, modal": ("G3 I5 F60\nI5", [("arc", "XY", 5, 0, 0, 0, 0, 5, 1, 60)] * 2),
    "helix": ("G3 X0 Y0 Z-4 I5 F60", [("arc", "XY", 5, 0, 0, 0, -4, 5, 1, 60)]),
    "helix of turns": ("G3 Z-4 I5 P3 F60", [("arc", "XY", 5, 0, 0, 0, -4, 5, 3, 60)]),
    "P adds full turns": ("G0 X10\nG2 X0 Y-10 I-10 P2 F60",
        [("rapid", 10, 0, 0), ("arc", "XY", 0, 0, 0, -10, 0, 10, -1.25, 60)]),
    "absolute centre": ("G0 X10 Y20\nG90.1 G2 X20 Y10 I10 J10 F60", [
        ("rapid", 10, 20, 0), ("arc", "XY", 10, 10, 20, 10, 0, 10, -0.25, 60)]),
    "back to incremental centre": ("G90.1\nG91.1\nG2 X10 I5 F60",
        [("arc", "XY", 5, 0, 10, 0, 0, 5, -0.5, 60)]),
    "incremental end": ("G0 X10\nG91 G3 X-10 Y10 I-10 F60",
        [("rapid", 10, 0, 0), ("arc", "XY", 0, 0, 0, 10, 0, 10, 0.25, 60)]),
    # a radius mismatch within the tolerance stays as it is written
    "slightly off the circle": ("G2 X10.02 I5 F60",
        [("arc", "XY", 5, 0, 10.02, 0, 0, 5, -0.5, 60)]),
    # planes: counter-clockwise turns z to x in ZX, y to z in YZ
    "ZX plane, z to x": ("G18 G0 Z10\nG3 X10 Z0 K-10 F60",
        [("rapid", 0, 0, 10), ("arc", "ZX", 0, 0, 10, 0, 0, 10, 0.25, 60)]),
    "ZX plane, x to z": ("G18 G0 X10\nG2 X0 Z10 I-10 F60",
        [("rapid", 10, 0, 0), ("arc", "ZX", 0, 0, 0, 0, 10, 10, -0.25, 60)]),
    "YZ plane": ("G19 G0 Y10\nG3 Y0 Z10 J-10 F60",
        [("rapid", 0, 10, 0), ("arc", "YZ", 0, 0, 0, 0, 10, 10, 0.25, 60)]),
    "YZ helix": ("G19 G3 X7 J5 F60", [("arc", "YZ", 5, 0, 7, 0, 0, 5, 1, 60)]),
    "back to XY": ("G18\nG17 G2 X10 I5 F60", [("arc", "XY", 5, 0, 10, 0, 0, 5, -0.5, 60)]),
    # the R format
    "R clockwise": ("G2 X10 Y10 R10 F60", [("arc", "XY", 10, 0, 10, 10, 0, 10, -0.25, 60)]),
    "R counter-clockwise": ("G3 X10 Y10 R10 F60", [("arc", "XY", 0, 10, 10, 10, 0, 10, 0.25, 60)]),
    "R clockwise, long": ("G2 X10 Y10 R-10 F60", [("arc", "XY", 0, 10, 10, 10, 0, 10, -0.75, 60)]),
    "R counter-clockwise, long": ("G3 X10 Y10 R-10 F60",
        [("arc", "XY", 10, 0, 10, 10, 0, 10, 0.75, 60)]),
    "R half circle": ("G2 X10 R5 F60", [("arc", "XY", 5, 0, 10, 0, 0, 5, -0.5, 60)]),
    "R short by rounding": ("G2 X10 R4.9995 F60", [("arc", "XY", 5, 0, 10, 0, 0, 5, -0.5, 60)]),
    "R with turns": ("G3 X10 Y10 Z6 R10 P2 F60", [("arc", "XY", 0, 10, 10, 10, 6, 10, 1.25, 60)]),
    "R in ZX": ("G18 G3 X10 Z10 R10 F60", [("arc", "ZX", 0, 10, 10, 0, 10, 10, 0.25, 60)]),
    # G4
    "dwell": ("G4 P1.5", [("dwell", 1.5)]),
    "dwell, then move": ("G4 P1 G1 X1 F60", [("dwell", 1.0), ("line", 1, 0, 0, 60)]),
    # units
    "inch": ("G20 G0 X1 Y-.5", [("rapid", INCH, -INCH / 2, 0)]),
    "inch feed": ("G20\nG1 X1 F10", [("line", INCH, 0, 0, 10 * INCH)]),
    "inch arc": ("G20\nG2 X1 I.5 F10", [("arc", "XY", INCH / 2, 0, INCH, 0, 0, INCH / 2, -0.5,
        10 * INCH)]),
    "inch R": ("G20\nG2 X1 R.5 F10", [("arc", "XY", INCH / 2, 0, INCH, 0, 0, INCH / 2, -0.5,
        10 * INCH)]),
    "the position survives the units": ("G0 X10\nG20\nG91 X1",
        [("rapid", 10, 0, 0), ("rapid", 10 + INCH, 0, 0)]),
    "the feed survives the units": ("F600\nG20\nG1 X1", [("line", INCH, 0, 0, 600)]),
    "back to mm": ("G20\nG21 G0 X1", [("rapid", 1, 0, 0)]),
    # distance
    "incremental": ("G91 G0 X1\nX1 Y2\nG90 X1",
        [("rapid", 1, 0, 0), ("rapid", 2, 2, 0), ("rapid", 1, 2, 0)]),
    # feed modes: G93 F is one over minutes
    "inverse time line": ("G93 G1 X3 Y4 F2", [("line", 3, 4, 0, 10)]),
    "inverse time without length": ("G93 G1 X0 F2", [("line", 0, 0, 0, 2)]),
    "inverse time arc": ("G93 G2 X10 I5 F2", [("arc", "XY", 5, 0, 10, 0, 0, 5, -0.5, 10 * np.pi)]),
    "inverse time helix": ("G93 G3 Z3 I5 F1", [("arc", "XY", 5, 0, 0, 0, 3, 5, 1,
        float(np.hypot(10 * np.pi, 3)))]),
    "back to feed a minute": ("G93 G1 X1 F1\nG94 F100 X2",
        [("line", 1, 0, 0, 1), ("line", 2, 0, 0, 100)]),
    "inverse time leaves traverses alone": ("G93\nG0 X1", [("rapid", 1, 0, 0)]),
    # coordinate systems
    "G10 L2": ("G10 L2 P1 X10 Y20\nG0 X1 Y1", [("rapid", 11, 21, 0)]),
    "G10 L2 P0 is the present system": ("G55\nG10 L2 P0 X10\nG0 X1\nG54 X1",
        [("rapid", 11, 0, 0), ("rapid", 1, 0, 0)]),
    "G10 L2 keeps the other axes": ("G10 L2 P1 X10 Y20\nG10 L2 P1 X5\nG0 X1 Y1",
        [("rapid", 6, 21, 0)]),
    "G10 L20": ("G0 X10\nG10 L20 P1 X2\nX3", [("rapid", 10, 0, 0), ("rapid", 11, 0, 0)]),
    "G10 L20 counts G92 in": ("G0 X10\nG92 X4\nG10 L20 P1 X1\nX1",
        [("rapid", 10, 0, 0), ("rapid", 10, 0, 0)]),
    "G10 L2 in inches": ("G20 G10 L2 P2 X1\nG21 G55 G0 X1", [("rapid", INCH + 1, 0, 0)]),
    "nine systems": (
        "".join(f"G10 L2 P{n} X{n}0\n" for n in range(1, 10))
        + "G0 " + "\n".join(f"{code} X0" for code in ["G54", "G55", "G56", "G57", "G58", "G59",
            "G59.1", "G59.2", "G59.3"]),
        [("rapid", 10 * n, 0, 0) for n in range(1, 10)],
    ),
    "the system holds from its own line on": ("G10 L2 P2 X100\nG0 X1 G55", [("rapid", 101, 0, 0)]),
    "G53": ("G10 L2 P1 X10\nG0 X1\nG53 X1\nX1",
        [("rapid", 11, 0, 0), ("rapid", 1, 0, 0), ("rapid", 11, 0, 0)]),
    "G53 is absolute under G91": ("G0 X5\nG91 G53 G1 X1 F60",
        [("rapid", 5, 0, 0), ("line", 1, 0, 0, 60)]),
    "G53 in inches": ("G20 G53 G0 X1", [("rapid", INCH, 0, 0)]),
    # G92 family
    "G92": ("G0 X10\nG92 X3 Y1\nX4 Y1", [("rapid", 10, 0, 0), ("rapid", 11, 0, 0)]),
    "G92 again": ("G0 X10\nG92 X3\nG92 X0\nX1", [("rapid", 10, 0, 0), ("rapid", 11, 0, 0)]),
    "G92 moves all systems": ("G10 L2 P2 X100\nG0 X10\nG92 X0\nG55 X0",
        [("rapid", 10, 0, 0), ("rapid", 110, 0, 0)]),
    "G92.1": ("G0 X10\nG92 X0\nG92.1\nX1\nG92.3\nX2",
        [("rapid", 10, 0, 0), ("rapid", 1, 0, 0), ("rapid", 2, 0, 0)]),
    "G92.2 and G92.3": ("G0 X10\nG92 X0\nG92.2\nX1\nG92.3\nX1",
        [("rapid", 10, 0, 0), ("rapid", 1, 0, 0), ("rapid", 11, 0, 0)]),
    "absolute centre sees the offsets": ("G92 X100 Y100\nG90.1 G2 X110 Y100 I105 J100 F60",
        [("arc", "XY", 5, 0, 10, 0, 0, 5, -0.5, 60)]),
    # path control
    "exact path, exact stop": ("G61\nG61.1", [("path", "exact-path", 0.0),
        ("path", "exact-stop", 0.0)]),
    "blend": ("G64\nG64 P.05\nG64 P.05 Q.1\nG20\nG64 P.001", [
        ("path", "blend", 0.0), ("path", "blend", 0.05), ("path", "blend", 0.0254)]),
    "blend within nothing": ("G64 P.1\nG64 P0",
        [("path", "blend", 0.1), ("path", "exact-path", 0.0)]),
    "holes are made on the exact path": ("G0 Z1\nG64 P.1\nG98 G81 Z-1 R1 F60\nG61\nG81 X1", [
        ("rapid", 0, 0, 1), ("path", "blend", 0.1),
        ("path", "exact-path", 0.0), ("line", 0, 0, -1, 60), ("rapid", 0, 0, 1),
            ("path", "blend", 0.1),
        ("path", "exact-path", 0.0), ("rapid", 1, 0, 1), ("line", 1, 0, -1, 60),
            ("rapid", 1, 0, 1)]),
    "threads are made on the exact path": ("G64\nS60 M3\nG33 Z1 K1", [
        ("path", "blend", 0.0), ("spindle", "cw", 60.0),
        ("path", "exact-path", 0.0), ("sync", 1.0), ("line", 0, 0, 1, 60), ("sync", 0.0),
            ("path", "blend", 0.0)]),
    # codes that cancel what is off anyway
    "header": ("G17 G21 G40 G49 G54 G64 G80 G90 G91.1 G94\nG0 X1",
        [("path", "blend", 0.0), ("rapid", 1, 0, 0)]),
    # spindle, coolant, tool
    "spindle": ("S1000 M3\nS2000\nM4\nM5", [
        ("spindle", "cw", 1000.0), ("spindle", "cw", 2000.0), ("spindle", "ccw", 2000.0),
            ("spindle", "off", 0.0)]),
    "speed before start": ("S500\nM3", [("spindle", "cw", 500.0)]),
    "coolant": ("M8\nM7\nM9", [("coolant", False, True), ("coolant", True, True),
        ("coolant", False, False)]),
    "tool": ("T3\nM6\nT4 M6", [("tool", 3), ("tool", 4)]),
    "a tool change stops the spindle": ("M3 S100\nM6 T1 M3", [
        ("spindle", "cw", 100.0), ("spindle", "off", 0.0), ("tool", 1), ("spindle", "cw", 100.0)]),
    "stops": ("M0\nM1\nM00", [("stop",), ("optional-stop",), ("stop",)]),
    "M2": ("G0 X1\nM2\nnonsense", [("rapid", 1, 0, 0), ("end",)]),
    "M30 stops spindle and coolant": ("M3 S1 M8\nM30", [
        ("spindle", "cw", 1.0), ("coolant", False, True), ("spindle", "off", 0.0),
            ("coolant", False, False), ("end",)]),
    # order of execution
    "one line, whole order": ("M0 X1 G1 G91 G55 M8 M3 T2 S9 F60 M6 G4 P2 (MSG,go)", [
        ("message", "go"),
        ("tool", 2), ("spindle", "cw", 9.0), ("coolant", False, True), ("dwell", 2.0),
            ("line", 1, 0, 0, 60), ("stop",)]),
    "F in the units of its own line": ("G20 G1 X1 F60", [("line", INCH, 0, 0, 60 * INCH)]),
    "offset, then move": ("G92.1 G0 X1", [("rapid", 1, 0, 0)]),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_programs_have_the_expected_blocks(name: str) -> None:
    source, expected = CASES[name]
    assert_blocks(source, *expected)


def test_blocks_name_their_lines() -> None:
    blocks = run("\nG0 X1\n\nX2\nM3 S1\nG2 X0 I-1 F9")
    assert [block.line for block in blocks] == [2, 5, 6]
    assert isinstance(blocks[0], Polyline)
    assert blocks[0].lines.tolist() == [2, 4]
    assert {block.file for block in blocks} == {"test.nc"}


def test_rotary_axes_turn_in_degrees_whatever_the_units() -> None:
    assert_blocks("G20 G0 X1 A90", ("rapid", INCH, 0.0, 0.0, 90.0), axes=XYZA)


def test_feed_is_in_degrees_only_if_no_linear_axis_moves() -> None:
    source = "G20\nG1 A90 F10\nX1 A0\nX2"
    expected = [
        ("line", 0, 0, 0, 90, 10),
        ("line", INCH, 0, 0, 0, 254),
        ("line", 2 * INCH, 0, 0, 0, 254),
    ]
    assert_blocks(source, *expected, axes=XYZA)


@pytest.mark.parametrize(
    ("words", "length"),
    [("X3 Y4 A90", 5.0), ("A90", 90.0), ("U6 V8 B10", 10.0), ("U1 Z2", 2.0)],
)
def test_inverse_time_uses_the_length_of_the_first_moving_group(words: str, length: float) -> None:
    block = run(f"G93 G1 {words} F60", axes=("x", "y", "z", "a", "b", "c", "u", "v", "w"))[0]
    assert isinstance(block, Polyline)
    assert block.feeds[0] == pytest.approx(length, rel=1e-14)


def test_other_axes_move_along_with_an_arc() -> None:
    axes = ("x", "y", "z", "a", "u")
    assert_blocks(
        "G2 X10 I5 A90 U3 F60",
        ("arc", "XY", 5.0, 0.0, 10.0, 0.0, 0.0, 90.0, 3.0, 5.0, -0.5, 60.0),
        axes=axes,
    )


def test_u_v_w_are_axes_and_k_is_an_offset_outside_a_nurbs() -> None:
    assert_blocks("G1 U1 V2 W3 F60\nG18 G2 Z10 K5", ("line", 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 60.0),
          ("arc", "ZX", 5.0, 0.0, 0.0, 0.0, 10.0, 1.0, 2.0, 3.0, 5.0, -0.5, 60.0),
              axes=("x", "y", "z", "u", "v", "w"))  # fmt: skip


def test_positions_have_the_axis_order_of_the_machine() -> None:
    assert end_of("G0 X1 Y2 Z3", axes=("z", "x", "y")) == [3.0, 1.0, 2.0]


def test_the_program_starts_at_the_machine_position() -> None:
    assert_blocks(
        "G91 G0 X1\nG90 Y0",
        ("rapid", 11.0, 20.0, 30.0),
        ("rapid", 11.0, 0.0, 30.0),
        start=np.array([10.0, 20.0, 30.0]),
    )


def test_block_delete_skips_a_faulty_line() -> None:
    assert_blocks(
        "G0 X1\n /G0 X2 [\nY1",
        ("rapid", 1.0, 0.0, 0.0),
        ("rapid", 1.0, 1.0, 0.0),
        block_delete=True,
    )


def test_numbers_equal_float() -> None:
    digits = "0.1234567890123456789012345"
    assert end_of(f"G0 X{digits}")[0] == float(digits)


def test_rounding_errors_do_not_prevent_a_full_circle() -> None:
    """Ten steps of 0.1 are not exactly 1.0, but an arc back to 1.0 is a full circle."""
    blocks = run("G91 G0 X.1\n" + "X.1\n" * 9 + "G90 G2 X1 I5 F60")
    assert blocks[1].turns == -1.0  # type: ignore[attr-defined]


def test_linuxcnc_reads_f_before_the_units_change() -> None:
    assert run("%\nG20 G1 X1 F60\n%", dialect="linuxcnc")[0].feeds.tolist() == [1.0]  # type: ignore[attr-defined]


def test_legal_but_unusual_lines_are_warned_about() -> None:
    warned: list[tuple[str, int, int, str]] = []
    run(
        "M3\nG20 F10\nG1 X1\nM2",
        dialect="linuxcnc",
        warn=lambda d: warned.append((d.code, d.line, d.column, d.severity)),
    )
    assert warned == [
        ("spindle-speed-missing", 1, 1, "warning"),
        ("feed-before-units", 2, 5, "warning"),
    ]


@pytest.mark.parametrize(
    "comment",
    ["(LOG, a)", "(logopen, a.txt)", "(LOGCLOSE)", "(probeopen a.txt)", "(PROBECLOSE)", "(py, a)"],
)
def test_comment_commands_of_other_controls_are_warned_about(comment: str) -> None:
    warned: list[tuple[str, int, int]] = []
    run(
        f"G0 X1\nG0 X2 {comment}\n(logarithm)\nM2",
        warn=lambda d: warned.append((d.code, d.line, d.column)),
    )
    assert warned == [("comment-not-active", 2, 7)]


@pytest.mark.parametrize("dialect", ["grbl", "fanuc"])
def test_an_abort_is_a_comment_in_dialects_without_it(dialect: str) -> None:
    warned: list[tuple[str, int, int, str]] = []
    run(
        "G0 X1.\nX2. (Abort, a)\nM30",
        dialect=dialect,
        warn=lambda d: warned.append((d.code, d.line, d.column, d.hint)),
    )
    assert warned == [("comment-not-active", 2, 5, "it stops the program on LinuxCNC only")]


@pytest.mark.parametrize(
    ("line", "warned"), [("G4 P500", True), ("G4 P500.", False), ("G4 P99", False)]
)
def test_a_dwell_that_looks_like_milliseconds_is_warned_about(line: str, warned: bool) -> None:
    found: list[tuple[str, int, int]] = []
    run(f"G0 X1\n{line}\nM2", warn=lambda d: found.append((d.code, d.line, d.column)))
    assert found == ([("dwell-long", 2, 4)] if warned else [])


def test_fanuc_milliseconds_are_not_a_long_dwell() -> None:
    run("G4 P500\nG4 P900000\nM30", dialect="fanuc", warn=lambda d: pytest.fail(d.render()))


def test_a_clean_program_has_no_warnings() -> None:
    run("G21 F100\nG1 X2\nG20\nG20 F10\nS1 M3\nG1 X1", warn=lambda d: pytest.fail(d.render()))


def test_long_runs_of_moves_are_split() -> None:
    blocks = run("G1 F60\n" + "\n".join(f"X{n}" for n in range(10_000)))
    assert [len(block.points) for block in blocks] == [4096, 4096, 1808]  # type: ignore[attr-defined]


def test_blocks_are_yielded_while_lines_are_read() -> None:
    from cnc.gcode.core.program import interpret
    from cnc.gcode.reader.source_text import Text

    read: list[int] = []

    def lines():  # type: ignore[no-untyped-def]
        for n in range(1_000_000):
            read.append(n)
            yield "M30" if n == 5000 else f"G0 X{n % 100}"

    blocks = interpret(Text.of_lines(lines(), "t"))
    next(blocks)
    assert len(read) < 10_000
    list(blocks)
    assert len(read) < 20_000, "nothing is read after M30 but what came with it"
