"""Programs that controllers read differently: by the manual of each, and by ``auto``."""

from __future__ import annotations

from typing import Any

import pytest

from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.model.blocks import ArcFeed, Dwell
from cnc.model.diagnostics import Diagnostic
from tests.support.gcode.gcode_cases import error_of, rows, run

MM = "G21 G90\n"
TWICE = "G21 G91\nG10 L2 P1 X10.\nG10 L2 P1 X10.\nG90 G54 G0 X5."
PECKS = "G83 X5. Z-6. R2. I2. J.5 K1. F100"
ABSOLUTE_CENTRE = "G0 X10. Y10.\nG2 X10. Y30. I10. J20. F100"
CYCLE = f"{MM}G0 X0. Y0. Z10.\n"
SUB = "M30\nO2000\nG91 G0 X1.\nG90\nM99"
NGC = ("linuxcnc", "mach3")
MACRO_B = ("fanuc", "haas")

ENDS = [
    # G10 L2 under G91: FANUC and Haas add, LinuxCNC and GRBL set.
    (("linuxcnc", "grbl", "mach3"), TWICE, [15, 0, 0]),
    (MACRO_B, TWICE, [25, 0, 0]),
    (("auto", *NGC, "grbl", *MACRO_B), f"{MM}G10 L2 P1 X10.\nG54 G0 X5.", [15, 0, 0]),
    # G92 and G52 move the zero; G10 L20 takes the position.
    (("auto", *NGC, "grbl", *MACRO_B), f"{MM}G0 X10. Y10.\nG92 X0. Y0.\nG0 X5.", [15, 10, 0]),
    (("auto", *NGC, *MACRO_B), f"{MM}G52 X10.\nG0 X5.", [15, 0, 0]),
    (("auto", *NGC, "grbl"), f"{MM}G0 X20.\nG10 L20 P1 X0.\nG0 X5.", [25, 0, 0]),
    # G28 with and without axis words.
    (("auto", *NGC, "grbl", *MACRO_B), f"{MM}G0 X9. Z9.\nG91 G28 Z0.\nG90", [9, 0, 0]),
    (("auto", *NGC, "grbl", "haas"), f"{MM}G0 X9. Z9.\nG28", [0, 0, 0]),
    # The hole's level without G98 and G99, and G81 under G91 (R from the start, Z from R).
    (NGC, f"{CYCLE}G91 G81 X5. Z-3. R-8. F100\nG80", [5, 0, 2]),
    (MACRO_B, f"{CYCLE}G91 G81 X5. Z-3. R-8. F100\nG80", [5, 0, 10]),
    (("auto",), f"{CYCLE}G91 G99 G81 X5. Z-3. R-8. F100\nG80", [5, 0, 2]),
    # Under G91, L repeats at L places.
    (("auto", *NGC, *MACRO_B), f"{CYCLE}G98 G91 G81 X5. Z-3. R-8. F100 L3\nG80", [15, 0, 10]),
    # Repeats of a subprogram: L everywhere, P with the number for FANUC.
    (("auto", *NGC, *MACRO_B), f"{MM}M98 P2000 L3\n{SUB}", [3, 0, 0]),
    (("fanuc",), f"{MM}M98 P32000\n{SUB}", [3, 0, 0]),
    (("fanuc",), f"{MM}M98 P42000\n{SUB}", [4, 0, 0]),
    (MACRO_B, f"{MM}M98 P7\nG0 X1.\nN90 G0 Y2.\nM30\nO7\nM99 P90", [0, 2, 0]),
    # Arithmetic: MOD and FIX of negative numbers, order of operations.
    (("linuxcnc", "mach3"), f"{MM}#1=[-7 MOD 3]\nG0 X#1", [2, 0, 0]),
    (MACRO_B, f"{MM}#1=[-7 MOD 3]\nG0 X#1", [-1, 0, 0]),
    (("linuxcnc", "mach3"), f"{MM}#1=FIX[-1.5]\nG0 X#1", [-2, 0, 0]),
    (MACRO_B, f"{MM}#1=FIX[-1.5]\nG0 X#1", [-1, 0, 0]),
    (("auto", *NGC, *MACRO_B), f"{MM}#1=2\nG0 X[10-2-3] Y[2+3*#1] Z[12/2/3]", [5, 8, 2]),
    # G51: P in thousandths without a point is FANUC's, Haas has a factor.
    (("fanuc",), f"{MM}G51 X0 Y0 Z0 P2000\nG0 X10.", [20, 0, 0]),
    (("haas",), f"{MM}G51 X0 Y0 Z0 P2\nG0 X10.", [20, 0, 0]),
    (("auto", *MACRO_B), f"{MM}G51 X0 Y0 Z0 P2.\nG0 X10.", [20, 0, 0]),
    # Polar mode: an angle under G91 is an increment of the angle.
    (("auto", *MACRO_B), f"{MM}G17 G16\nG0 X10. Y30.\nG91 Y60.\nG90 G15", [0, 10, 0]),
    # Units and feeds.
    (("auto", "mach3", "siemens"), "G70 G90\nG0 X1. Y1.", [25.4, 25.4, 0]),
    (("auto", "mach3", "siemens"), "G71 G90\nG0 X1. Y1.", [1, 1, 0]),
    (("auto", *NGC, "grbl", *MACRO_B), "G20 G90\nG0 X1. Y1.", [25.4, 25.4, 0]),
    # G53 under G91 is absolute, where a controller takes it.
    (("auto", "grbl", "mach3"), "G21 G91\nG0 X5.\nG0 X5.\nG53 G0 X3.", [3, 0, 0]),
    (("siemens",), "G71 G91\nG0 X5.\nG0 X5.\nG53 G0 X3.", [3, 0, 0]),
    # After G80 the move before the cycle.
    (("auto", *MACRO_B), f"{MM}G1 X1. F100\nG81 X5. Z-3. R2.\nG80\nX9.", [9, 0, 2]),
]  # fmt: skip

REFUSED = [
    (("auto",), "G21 G91\nG10 L2 P1 X1.", "offset-incremental"),
    (("auto", *NGC, "grbl", "haas"), f"{MM}G2 X10. Y0. R5. I5. J0. F100", "arc-radius-and-center"),
    (("auto", *NGC, "grbl", *MACRO_B), f"{MM}G2 X10. Y0. F100", "arc-center-missing"),
    (("auto", *NGC, "grbl", *MACRO_B), f"{MM}G2 X0. Y0. R5. F100", "arc-radius-no-chord"),
    (("auto", *NGC, "grbl", *MACRO_B), f"{MM}G93 G1 X5. F2.\nX9.", "feed-missing"),
    (("auto", *MACRO_B), "G21 G91\nG68 X0. Y0. R30.", "rotation-incremental"),
    (("auto",), f"{MM}G51 X0 Y0 Z0 P2000", "scaling-factor"),
    (("auto", *NGC, "haas"), f"{MM}M98 P32000\n{SUB}", "program-unknown"),
    (("auto", *NGC), f"{MM}M98 P7\nM30\nO7\nM99 P90", "word-unused"),
    (("fanuc",), f"{MM}G28", "axis-words-missing"),
    (("fanuc",), f"{MM}G4 P2.5", "decimal-point-place"),
    (("auto",), f"{MM}G4 X2000", "decimal-point-needed"),
    ((*NGC, *MACRO_B), f"{MM}M6", "tool-not-chosen"),
    (MACRO_B, f"{MM}G43 Z10.", "tool-offset-missing"),
    (MACRO_B, f"{MM}G41 G1 X5. F100", "compensation-offset-missing"),
    (("linuxcnc", *MACRO_B), "G21 G91\nG53 G0 Z0.", "machine-coordinates-incremental"),
    (("linuxcnc", "mach3"), f"{MM}G1 X1. F100\nG81 X5. Z-3. R2.\nG80\nX9.", "motion-missing"),
    (("auto", "linuxcnc", "fanuc"), CYCLE + PECKS, "cycle-word-missing"),
    (("auto", *NGC, "grbl", *MACRO_B), MM + ABSOLUTE_CENTRE, "arc-radius-mismatch"),
]  # fmt: skip

CHOICES = [
    (f"{CYCLE}G91 G81 X5. Z-3. R-8. F100\nG80", "cycle-level-unclear"),
    (f"{MM}G1 X1. F100\nG81 X5. Z-3. R2.\nG80\nX9.", "motion-assumed"),
    (f"{MM}G4 P500", "dwell-long"),
    ("G21 G91\nG53 G0 X1.", "machine-coordinates-absolute"),
    (f"{MM}X10.", "motion-assumed"),
]


def last(source: str, dialect: Any) -> list[float]:
    found = rows(run(f"{source}\nM30", dialect=dialect))
    moves = [row for row in found if row[0] in ("rapid", "line")]
    return [float(value) for value in moves[-1][1:4]]


@pytest.mark.parametrize(("dialects", "source", "end"), ENDS)
def test_each_dialect_reads_a_program_by_its_manual(
    dialects: tuple[str, ...], source: str, end: list[float]
) -> None:
    for dialect in dialects:
        assert last(source, dialect) == pytest.approx(end, abs=1e-9), dialect


@pytest.mark.parametrize(("dialects", "source", "code"), REFUSED)
def test_a_program_is_refused_where_its_meaning_is_open(
    dialects: tuple[str, ...], source: str, code: str
) -> None:
    for dialect in dialects:
        assert error_of(f"{source}\nM30", dialect=dialect).code == code, dialect


@pytest.mark.parametrize(("source", "code"), CHOICES)
def test_auto_names_its_choice(source: str, code: str) -> None:
    found: list[str] = []
    run(f"{source}\nM30", dialect="auto", warn=lambda each: found.append(each.code))
    assert code in found


TOOL = ToolEntry(1, offsets={"Z": 40.0}, diameter=6.0)


@pytest.mark.parametrize("code", ["G43 G0 Z10.", "G41 G1 X9. Y9. F100\nX20.\nG40 X30. Y0."])
def test_auto_names_the_tool_of_a_code_without_h_or_d(code: str) -> None:
    source = f"{MM}T1 M6\n{code}\nM30"
    for dialect, expected in (("auto", 1), ("linuxcnc", 0)):
        found: list[Diagnostic] = []
        run(source, dialect=dialect, tools=ToolTable([TOOL]), warn=found.append)
        assert [each.code for each in found].count("tool-offset-assumed") == expected, dialect


def test_r_of_an_arc_comes_before_its_centre_for_fanuc() -> None:
    found: list[str] = []
    source = f"{MM}G2 X10. Y0. R5. I9. J0. F100\nM30"
    blocks = run(source, dialect="fanuc", warn=lambda each: found.append(each.code))
    arc = next(block for block in blocks if isinstance(block, ArcFeed))
    assert arc.center == pytest.approx((5, 0), abs=1e-9)
    assert "word-without-effect" in found


@pytest.mark.parametrize(
    ("dialect", "word", "seconds"),
    [
        ("linuxcnc", "P2", 2), ("grbl", "P2.5", 2.5), ("auto", "P2", 2), ("mach3", "P2", 2),
        ("fanuc", "P2000", 2), ("haas", "P2000", 2), ("haas", "P2.", 2), ("fanuc", "X2.", 2),
        ("siemens", "F2", 2), ("marlin", "P2000", 2), ("marlin", "S2", 2), ("auto", "X2.", 2),
    ],
)  # fmt: skip
def test_the_time_of_a_dwell(dialect: Any, word: str, seconds: float) -> None:
    end = "" if dialect == "marlin" else "M30"
    units = "G71 G90\n" if dialect == "siemens" else MM
    blocks = run(f"{units}G4 {word}\n{end}", dialect=dialect)
    assert [block.seconds for block in blocks if isinstance(block, Dwell)] == [seconds]


@pytest.mark.parametrize("dialect", ["auto", "linuxcnc", "grbl", "fanuc", "haas", "siemens"])
def test_a_negative_radius_is_more_than_half_a_turn(dialect: Any) -> None:
    units, radius = ("G71 G90\n", "CR=-6") if dialect == "siemens" else (MM, "R-6.")
    blocks = run(f"{units}G2 X10. Y0. {radius} F100\nM30", dialect=dialect)
    arc = next(block for block in blocks if isinstance(block, ArcFeed))
    # Chord 10 and radius 6: the centre is sqrt(36 - 25) above the chord, on the way clockwise.
    assert arc.center == pytest.approx((5, 11**0.5), abs=1e-9)
