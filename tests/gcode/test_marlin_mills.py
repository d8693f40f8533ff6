"""Programs of mills, plotters and dispensers with Marlin's firmware, and texts behind a stop.

Source: Marlin, "G-code Index"; Snapmaker, "G-code Reference", M3.
"""

from __future__ import annotations

import pytest

from cnc.gcode import dialects
from cnc.gcode.dialects.recognition import recognise, refuse
from cnc.model.diagnostics import Diagnostic, GcodeError
from tests.support.gcode.gcode_cases import block_summaries, error_of, run

MARLIN = dialects.load("marlin", lenient=True)
AUTO = dialects.load("auto")

MILLS = [
    "; post: MPCNC\nG21\nM84 S0",
    ";header_type: cnc\nG0 Z5 F400",
    "; Snapmaker Luban",
    "M3 P100\nG0 Z5 F400",
    "M84 S1800\nG1 X5 F400",
    "M117 2D contour\nM400",
    "M106 S255\nG4 P900\nM106 S0",
    "M300 S30 (pen down)\nG4 P150\nM18",
    "G28 X Y\nG1 X5 F100",
    "G28 X0\nG92 X0 Y0 Z0 E0 ; a template\nG1 X5 F100",
]


@pytest.mark.parametrize("source", MILLS)
def test_a_mill_with_the_firmware_of_printers_is_no_printer(source: str) -> None:
    found = recognise(source.split("\n"))
    assert (found.dialect, found.prints) == ("marlin", False)
    refuse(found, "mill", "part.gcode")


PRINTERS = ["M104 S200\nG1 X5 F100", "G28\nM106 S128\nG1 X5 E0.2", "; sliced by Slic3r\nM84"]


@pytest.mark.parametrize("source", PRINTERS)
def test_a_program_that_heats_or_feeds_filament_is_a_printers(source: str) -> None:
    with pytest.raises(GcodeError) as caught:
        refuse(recognise(source.split("\n")), "mill", "part.gcode")
    assert caught.value.diagnostic.code == "program-for-printer"


MILLING = [
    ("O1001\nG97 S441 M3 P11\nG0 X1.", "fanuc"),
    ("O00100\nG54 T1 M6\nM83\nG4 P1.\nM84", "haas"),
    ("T1 M6\nS1000 M3\nM400\nG1 X5 F100", "auto"),
    ("M3 S1000 P1\nG1 X5 F100", "auto"),
    ("M5\nM17\nG15\nG1 X5 F100", "auto"),
    ("%\n( post: MPCNC21.cps)\nM62 P0", "grbl"),
]


@pytest.mark.parametrize(("source", "dialect"), MILLING)
def test_a_builders_code_alone_does_not_name_the_firmware(source: str, dialect: str) -> None:
    assert recognise(source.split("\n")).dialect == dialect


@pytest.mark.parametrize(
    ("line", "blocks"),
    [
        ("G4 P900", ["dwell 0.9"]),
        ("M117 2D contour (1)", []),
        ("M118 E1 ready", []),
        ("M114 D", []),
        ("M3 P100", ["spindle cw 0"]),
        ("M84 S0", []),
    ],
)
def test_lines_of_the_firmware(line: str, blocks: list[str]) -> None:
    assert block_summaries(line, dialect=MARLIN) == blocks


def test_the_firmware_begins_with_a_feed() -> None:
    assert block_summaries("G1 X5\nG1 X6 F300\nX7", dialect=MARLIN) == [
        "line 5 0 0 F1500", "line 6 0 0 F300", "line 7 0 0 F300",
    ]  # fmt: skip
    assert warnings_of("G1 X5\nX6", MARLIN) == ["feed-assumed"]
    assert warnings_of("G0 X5 F400\nG1 X6", MARLIN) == []
    assert error_of("G1 X5", dialect=AUTO).code == "feed-missing"


def test_homing_has_no_point_on_its_way() -> None:
    rows = block_summaries("G92 X5\nG0 X9 Y9\nG28 X0 Y0", dialect=MARLIN)
    assert rows == ["rapid 4 9 0", "rapid 0 0 0"]
    rows = block_summaries("G92 X5\nG0 X9 Y9\nG28 X0 Y0", dialect=AUTO)
    assert rows == ["rapid 4 9 0", "rapid -5 0 0", "rapid 0 0 0"]


def warnings_of(source: str, dialect: dialects.Dialect) -> list[str]:
    found: list[Diagnostic] = []
    run(source, warn=found.append, dialect=dialect)
    return [each.code for each in found]


@pytest.mark.parametrize("stop", ["M0 Turn ON 500 RPM", "M00 Insert T2 (a)", "N5 M1 change it"])
@pytest.mark.parametrize("dialect", [AUTO, MARLIN])
def test_a_text_behind_a_stop_is_a_message(stop: str, dialect: dialects.Dialect) -> None:
    assert block_summaries(stop, dialect=dialect)[0] in ("stop", "optional-stop")
    assert "comment-mended" in warnings_of(stop, dialect)


@pytest.mark.parametrize("stop", ["M0 GOTO 5", "M0 IF [1 EQ 1]", "M0 XX5"])
def test_code_behind_a_stop_is_an_error(stop: str) -> None:
    assert error_of(stop, dialect="auto").severity == "error"


def test_slashes_begin_a_comment_behind_code() -> None:
    assert block_summaries("G0 X5 // move to 10", dialect=AUTO) == ["rapid 5 0 0"]
    assert warnings_of("G0 X5 // set units", AUTO) == ["comment-mended"]
    assert error_of("G0 X5 // Y7", dialect=AUTO).code == "block-delete-place"


@pytest.mark.parametrize("line", ["H0", "D0", "H3", "D3"])
def test_an_offset_alone_is_no_slip(line: str) -> None:
    assert error_of(f"M6 T3\nG0 X1\n{line}", dialect=AUTO).code == "word-unused"


@pytest.mark.parametrize("line", ["T3 H3", "T3 D3 M6", "M6 T3 H3 D3"])
def test_the_offsets_of_the_chosen_tool_may_stand_beside_it(line: str) -> None:
    assert "word-idle" in warnings_of(line, AUTO)
    other = line.replace("H3", "H4").replace("D3", "D4")
    assert error_of(other, dialect=AUTO).code == "word-unused"


def test_percent_and_a_text_is_for_the_sender() -> None:
    program = "%\n% vfd on\n%( start )\nG0 X5"
    grbl = dialects.load("grbl", lenient=True)
    assert block_summaries(program, dialect=grbl) == ["rapid 5 0 0"]
    assert warnings_of(program, grbl) == ["code-not-needed"]
    assert error_of("%\nG0 X1\n%\nG0 X5", dialect=grbl).code == "percent-place"


@pytest.mark.parametrize("dialect", ["auto", "fanuc", "mach3"])
def test_a_tool_change_without_a_tool_stops_for_the_operator(dialect: str) -> None:
    lenient = dialects.load(dialect, lenient=True)
    assert block_summaries("S900 M3\nM6\nG0 X1.", dialect=lenient) == [
        "spindle cw 900", "spindle off 0", "stop", "rapid 1 0 0",
    ]  # fmt: skip
    assert "tool-change-by-hand" in warnings_of("M6", lenient)
    if dialect != "auto":
        assert error_of("M6", dialect=dialect).code == "tool-not-chosen"
