"""The heights of a drilling cycle where the distance mode changes, by dialect."""

from __future__ import annotations

import itertools

import pytest

from tests.support.gcode.gcode_cases import error_of, points, warnings


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
@pytest.mark.parametrize(
    ("cycle", "depths"),
    [
        # The heights of the first line hold, whatever the distance mode of the next ones.
        ("G90 G99 G81 X1. Z-4. R1. F50.\nG91 X2. L2\nG90 X9.", [(1, -4)] * 4),
        ("G91 G98 G81 X1. Z-6. R-5. F50.\nX2. L2\nG90 X9.", [(5, -1)] * 4),
        ("G90 G99 G81 X1. Z-4. R1. F50.\nG91 X2. Z-3.\nX3.", [(1, -4), (1, -2), (1, -2)]),
        ("G90 G99 G81 X1. Z-4. R1. F50.\nG91 X2. R-8.\nG90 X9. Z-5.", [(1, -4), (2, -4), (2, -5)]),
    ],
)
def test_heights_of_a_cycle_stay_under_the_other_distance_mode(
    cycle: str, depths: list[tuple[float, float]], dialect: str
) -> None:
    """The grid of holes of Haas' manual: a row is G91 X1. L2 after G81 under G90."""
    moves = points(f"G90 G0 Z10.\n{cycle}\nG80", dialect)
    pairs = itertools.pairwise(moves)
    found = [(above[2], hole[2]) for above, hole in pairs if hole[2] < min(0.0, above[2])]
    assert found == depths


def test_heights_under_the_other_distance_mode_by_dialect() -> None:
    program = "G90 G0 Z10\nG99 G81 X1 Z-4 R1 F50\nG91 X2\nG80"
    found = error_of(program, dialect="auto")
    assert (found.code, found.line) == ("cycle-distance-mode", 3)
    assert "--dialect" in found.hint
    given = program.replace("G91 X2", "G91 X2 Z-3 R2")
    assert points(given, "auto")[-2:] == [(3, 0, 9), (3, 0, 12)]
    # LinuxCNC counts R from the height at the start of the cycles, and the depth from R.
    assert (3, 0, 7) in points(f"{program}\nM2", "linuxcnc")


@pytest.mark.parametrize(
    ("cycle", "dialect", "above", "lines"),
    [
        ("G81 X1 Z-4 R1 F50\nX2\nX3", "auto", [9, 9, 9], [3]),
        ("G81 X1 Z-4 R1 F50\nX2\nG80\nG81 X3 Z-4 R1", "auto", [9, 9, 9], [3]),
        ("G98 G81 X1 Z-4 R1 F50\nX2", "auto", [9, 9], []),
        ("G99 G81 X1 Z-4 R1 F50\nX2", "auto", [1, 1], []),
        ("G99\nG81 X1 Z-4 R1 F50\nX2", "auto", [1, 1], []),
        ("G81 X1 Z-4 R9 F50\nX2", "auto", [9, 9], []),
        ("G81 X1 Z-4 R9 F50\nX2 R1", "auto", [9, 9], [4]),
        ("G81 X1 Z-4 R1 F50\nX2", "linuxcnc", [1, 1], []),
        ("G81 X1 Z-4 R1 F50\nX2", "fanuc", [9, 9], []),
        ("G81 X1 Z-4 R1 F50\nX2", "mach3", [1, 1], []),
    ],
)
def test_a_level_between_the_holes_that_dialects_read_differently_is_reported(
    cycle: str, dialect: str, above: list[float], lines: list[int]
) -> None:
    program, warnings = f"G21 G90\nG0 Z9\n{cycle}\nG80\nM2", []
    moves = points(program, dialect, warn=warnings.append)
    found = [end[2] for hole, end in itertools.pairwise(moves) if hole[2] == -4]
    assert found == above
    unclear = [each.line for each in warnings if each.code == "cycle-level-unclear"]
    assert unclear == lines


@pytest.mark.parametrize(("units", "scale"), [("G21", 1.0), ("G20", 25.4)])
def test_a_hole_of_haas_without_r_begins_at_the_level(units: str, scale: float) -> None:
    """Haas' manual marks R as optional; the second hole has the R of the first."""
    program = f"{units}\nG54 G0 Z2.\nG99 G81 X1. Z-1. F50.\nX3.\nG80\nM30"
    ends = [(0, 2), (1, 2), (1, -1), (1, 2), (3, 2), (3, -1), (3, 2)]
    found = [(x, z) for x, _, z in points(program, "haas")]
    assert found == [pytest.approx((x * scale, z * scale), abs=1e-9) for x, z in ends]
    said = [each for each in warnings(program, "haas") if each.code == "cycle-level-assumed"]
    assert [each.line for each in said] == [3]


def test_a_hole_of_fanuc_needs_r() -> None:
    program = "G21\nG0 Z2.\nG81 X1. Z-1. F50.\nM30"
    assert error_of(program, dialect="fanuc").code == "cycle-word-missing"
