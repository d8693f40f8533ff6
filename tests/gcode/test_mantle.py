"""Cylindrical interpolation: points of the mantle by unrolling the moves of the axes, errors."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.turning.virtual_axis import TOLERANCE
from cnc.model.blocks import PathMode, Polyline
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.gcode_cases import block_summaries, run

LATHE, MILL = ("x", "c", "z"), ("x", "y", "z", "a")
LIVE = "G98 G97 S600 M3\nG0 X60. C0. Z5.\n"
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)


def options(dialect: str, axes: tuple[str, ...] = LATHE, orientation: int = 0) -> dict[str, object]:
    """Options of a lathe with a C axis, or of a mill with an A axis."""
    lathe = "A" if axes[1] == "c" and dialect != "siemens" else None
    return {
        "dialect": dialects.load(dialect, lathe=lathe),  # type: ignore[arg-type]
        "axes": axes,
        "lathe": axes[1] == "c",
        "policy": ReadingPolicy(tool_lengths="zero"),
        "tools": ToolTable([ToolEntry(1, 1, {}, 8.0, orientation=orientation)]),
    }


class Mantle:
    """The moves of a program between the two changes of the path control, unrolled."""

    def __init__(self, source: str, dialect: str, radius: float, **given: object) -> None:
        chosen = options(dialect, **given)  # type: ignore[arg-type]
        axes: tuple[str, ...] = chosen["axes"]  # type: ignore[assignment]
        turns, along = ("c", "z") if "c" in axes else ("a", "x")
        self.moves: list[tuple[complex, complex, float]] = []
        self.seconds = 0.0
        here, inside = [0.0] * len(axes), 0
        for block in run(f"{source}\nM30", **chosen):
            inside += isinstance(block, PathMode)
            if not isinstance(block, Polyline):
                continue
            for end, feed in zip(block.points.tolist(), block.feeds.tolist(), strict=True):
                step = dict(zip(axes, (b - a for a, b in zip(here, end, strict=True)), strict=True))
                linear = math.hypot(*(step[name] for name in axes if name in "xyz"))
                if inside == 1:
                    a, b = (
                        complex(place[axes.index(along)],
                                math.radians(place[axes.index(turns)]) * radius)
                        for place in (here, end)
                    )  # fmt: skip
                    self.moves.append((a, b, end[axes.index("x")]))
                    if not math.isnan(feed):
                        self.seconds += (linear or abs(step[turns])) / feed
                here = end
        assert inside == 2


CORNERS = [5 + 0j, 0 + 0j, 0 + 15j, -10 + 20j, -10 + 0j]
"""Along the axis and round the mantle, mm."""
WAY = math.degrees(1.0 / 20.0)
"""Degrees of a millimetre on a mantle of 20 mm radius."""
LINES = {
    "fanuc": f"{LIVE}G7.1 C20.\nG1 Z0. F300.\nC{15 * WAY:.9f}\nC{20 * WAY:.9f} Z-10.\n"
    f"H-{20 * WAY:.9f}\nG7.1 C0",
    "haas": f"{LIVE}G107 C0 Y0 Q40.\nG1 Z0. F300.\nY15.\nY20. Z-10.\nY0\nG107",
    "siemens": "G94 G97 S600 M3 DIAMOF\nG0 X30 C0 Z5\nTRACYL(40)\nG19\nG1 Z0 F300\nY15\nY20 Z-10\n"
    "Y0\nTRAFOOF\nG18",
}  # fmt: skip


@pytest.mark.parametrize("dialect", LINES)
def test_straight_lines_are_straight_and_keep_the_feed(dialect: str) -> None:
    mantle = Mantle(LINES[dialect], dialect, 20.0)
    assert len(mantle.moves) == 4
    for (a, b, x), ends in zip(mantle.moves, pairwise(CORNERS), strict=True):
        assert (a, b) == pytest.approx(ends, abs=1e-8)
        assert x == 30.0
    length = sum(abs(b - a) for a, b in pairwise(CORNERS))
    assert mantle.seconds == pytest.approx(length / 5.0, rel=1e-9)


MANUAL = """G0 X60. Z100. C0.
G1 G18 W0 H0 F250.
G7.1 C57.299
G1 Z120.
C30.
G3 Z90. C60. R30.
G1 Z70.
G2 Z60. C70. R10.
G1 C150.
G2 Z70. C190. R75.
G1 Z110. C230.
G3 Z120. C270. R75.
G1 C360.
G7.1 C0"""
"""The contour of FANUC's manual; on a mantle of 57.299 mm radius a degree is a millimetre, but for
0.006 per cent."""


def test_the_contour_of_the_manual() -> None:
    mantle = Mantle(f"G98 G97 S600 M3\n{MANUAL}", "fanuc", 180.0 / math.pi)
    ends = [b for _, b, _ in mantle.moves]
    for corner in (120 + 30j, 90 + 60j, 70 + 60j, 60 + 70j, 60 + 150j, 70 + 190j, 110 + 230j,
                   120 + 270j, 120 + 360j):  # fmt: skip
        assert min(abs(end - corner) for end in ends) < 1e-6
    # The centres of the quarters of a circle: both are tangent to the lines beside them.
    for centre, radius, corner in (
        (90 + 30j, 30.0, 90 + 60j),
        (70 + 70j, 10.0, 60 + 70j),
    ):
        last = next(k for k, end in enumerate(ends) if abs(end - corner) < 1e-6)
        arc = [end for end in ends[:last] if abs(abs(end - centre) - radius) < 0.01]
        assert len(arc) > 10


@pytest.mark.parametrize("code", ["G3 J-8. K0", "G2 J-8. K0"])
def test_a_circle_on_the_mantle(code: str) -> None:
    source = f"{LIVE}G19\nG107 C0 Y0 R20.\nG1 Z0 Y8. F600.\n{code} Y8. X58.\nG107\nG18"
    mantle = Mantle(source, "haas", 20.0)
    arc = mantle.moves[1:]
    for a, b, _ in arc:
        for share in SHARES:
            assert abs(abs(a + share * (b - a)) - 8.0) <= TOLERANCE * 1.01
    # The plane YZ: anticlockwise turns the way along the mantle towards Z.
    turned = math.copysign(1.0, (arc[0][1] / arc[0][0]).imag)
    assert turned == (-1.0 if code.startswith("G3") else 1.0)
    assert arc[-1][1] == pytest.approx(8j)
    assert arc[-1][2] == 29.0
    first = Mantle(f"{LIVE}G107 C0 Y0 R20.\nG1 Z0 Y8. F600.\nG107", "haas", 20.0).seconds
    length = math.hypot(math.tau * 8.0, 1.0)
    assert mantle.seconds - first == pytest.approx(length / 10.0, rel=1e-4)


@pytest.mark.parametrize("plane", ["G18", "G19"])
def test_the_plane_says_which_way_an_arc_turns(plane: str) -> None:
    # From z 10 to 10 mm along the mantle: in ZC anticlockwise is the short way.
    code = "G3" if plane == "G18" else "G2"
    source = f"{LIVE}{plane}\nG7.1 C20.\nG1 Z10. F600.\n{code} Z0 C{10 * WAY:.9f} R10.\nG7.1 C0"
    mantle = Mantle(source, "fanuc", 20.0)
    assert all(abs(abs(b) - 10.0) < 1e-6 for _, b, _ in mantle.moves)


@pytest.mark.parametrize("orientation", [0, 3])
def test_cutter_compensation_acts_on_the_mantle(orientation: int) -> None:
    source = (
        f"{LIVE}T0101\nG0 X60. C0. Z20.\nG7.1 C20.\nG1 G42 Z10. F600.\nC{10 * WAY:.9f}\nZ-10.\n"
        f"C{-10 * WAY:.9f}\nZ10.\nC0\nG40 Z20.\nG7.1 C0"
    )
    places = [b for _, b, _ in Mantle(source, "fanuc", 20.0, orientation=orientation).moves]
    # The path is a square of 20 mm; the centre of the cutter, of 8 mm, is 4 mm outside it.
    for corner in (14 + 14j, -14 + 14j, -14 - 14j, 14 - 14j):
        assert min(abs(place - corner) for place in places) < 4.0
    for place in places[:-1]:
        off = math.hypot(max(abs(place.real) - 10.0, 0.0), max(abs(place.imag) - 10.0, 0.0))
        assert off == pytest.approx(4.0, abs=TOLERANCE)


def test_c_and_its_words_are_as_before_afterwards() -> None:
    source = f"{LIVE}G0 C30.\nG7.1 C10.\nG1 Z0. F600.\nC90. X50.\nG7.1 C0\nG0 H10.\nG3 X60. Z5. R5."
    found = block_summaries(f"{source}\nM30", **options("fanuc"))
    assert found[2] == "rapid 30 30 5"
    moved = 60.0 * math.radians(10.0)
    feed = 600.0 * 5.0 / math.hypot(5.0, moved)
    assert found[4:6] == ["line 30 30 0 F600", f"line 25 90 0 F{round(feed, 6):.10g}"]
    assert found[7] == "rapid 25 100 0"
    assert found[8].startswith("arc zx")


def test_a_radius_without_a_decimal_point_counts_least_increments() -> None:
    # The manual's G07.1 H57299, where bit 0 of parameter 3401 is 0: a degree is a millimetre.
    text = "G98 G97 S600 M3\nG0 X60. C0. Z0.\nG7.1 H57299\nG1 Z-3. C4. F300.\nG7.1 C0\nM30"
    rules = dialects.load("fanuc", lathe="A", least_increments=True)
    moves = block_summaries(text, **options("fanuc") | {"dialect": rules})
    way = 4.0 * math.radians(57.299)
    assert f"line 30 4 -3 F{round(300.0 * 3.0 / math.hypot(3.0, way), 6):.10g}" in moves


def test_a_dwell_is_allowed() -> None:
    text = f"{LIVE}G7.1 C20.\nG4 X1.\nG1 Z0 F300.\nG7.1 C0\nM30"
    assert "dwell 1" in block_summaries(text, **options("fanuc"))


def test_inches() -> None:
    inch = Mantle(
        "G98 G97 S600 M3\nG20\nG0 X2. C0. Z0.\nG7.1 C1.\nG1 Z-1. C90. F20.\nG7.1 C0", "fanuc", 25.4
    )
    assert inch.moves[0][1] == pytest.approx(complex(-25.4, 25.4 * math.pi / 2.0))
    length = 25.4 * math.hypot(1.0, math.pi / 2.0)
    assert inch.seconds == pytest.approx(length / (20.0 * 25.4 / 60.0))


def test_a_mill_with_a_rotary_axis_along_x() -> None:
    source = (
        "G90 G94 S600 M3\nG0 X0. Y0. Z10. A0.\nG1 Z-1. F300.\nG7.1 A20.\n"
        f"G17 G2 X10. A{10 * WAY:.9f} R10.\nG1 X20. A{20 * WAY:.9f}\nG7.1 A0"
    )
    mantle = Mantle(source, "fanuc", 20.0, axes=MILL)
    # Clockwise in XA from the start to (10, 10): about the centre (10, 0).
    arc = mantle.moves[:-1]
    assert all(abs(abs(b - 10.0) - 10.0) < 1e-6 for _, b, _ in arc)
    assert mantle.moves[-1][1] == pytest.approx(20 + 20j)
    length = 10.0 * math.pi / 2.0 + math.hypot(10.0, 10.0)
    assert mantle.seconds == pytest.approx(length / 5.0, rel=1e-4)


ERRORS = {
    "no C axis": ("fanuc", "G0 X60. Z5.\nG7.1 C20.", "axis-missing", ("x", "z")),
    "no letter": ("fanuc", "G7.1", "mantle-words", LATHE),
    "a negative radius": ("fanuc", "G7.1 C-20.", "value-out-of-range", LATHE),
    "another radius": ("fanuc", "G7.1 C20.\nG7.1 C30.", "face-code", LATHE),
    "on the face, too": ("fanuc", "G12.1\nG7.1 C30.", "face-code", LATHE),
    "a traverse": ("fanuc", "G7.1 C20.\nG0 Z0", "face-code", LATHE),
    "a traverse in effect": ("fanuc", "G0 Z1.\nG7.1 C20.\nZ0", "face-code", LATHE),
    "a tool": ("fanuc", "G7.1 C20.\nT0101", "face-code", LATHE),
    "a tool beside a dwell": ("fanuc", "G7.1 C20.\nG4 X1. T0101", "face-code", LATHE),
    "a cycle": ("fanuc", "G7.1 C20.\nG90 X30. Z-5.", "face-code", LATHE),
    "a centre": ("fanuc", "G7.1 C20.\nG3 Z0 C10. K-5. I0", "face-code", LATHE),
    "an arc in XY": ("fanuc", "G17\nG7.1 C20.\nG3 X0 C10. R50.", "mantle-plane", LATHE),
    "a corner in XY": ("fanuc", "G17\nG7.1 C20.\nG1 Z0,R1. F9.\nC9.", "mantle-plane", LATHE),
    "the face in the mantle": ("fanuc", "G7.1 C20.\nG12.1", "face-code", LATHE),
    "the end of the face": ("fanuc", "G7.1 C20.\nG13.1", "face-code", LATHE),
    "TRANSMIT in the mantle": ("siemens", "TRACYL(40)\nTRANSMIT", "face-code", LATHE),
    "TRACYL on the face": ("siemens", "G0 X9\nTRANSMIT\nTRACYL(40)", "face-code", LATHE),
    "compensation in XY": ("fanuc", "T0101\nG17\nG7.1 C20.\nG41 G1 Z0 F10.", "mantle-plane", LATHE),
    "compensation before": (
        "fanuc", "T0101\nG1 X100. F100.\nG42 X50.\nZ-10.\nG7.1 C20.", "compensation-active", LATHE
    ),
    "compensation behind": (
        "fanuc", "T0101\nG7.1 C20.\nG1 G42 Z0 F100.\nG7.1 C0", "compensation-active", LATHE
    ),
    "a linear axis": ("haas", "G107 C0 X0 R20.", "code-not-supported", LATHE),
    "no linear axis": ("haas", "G107 C0 R20.", "mantle-words", LATHE),
    "no size": ("haas", "G107 C0 Y0", "mantle-words", LATHE),
    "two sizes": ("haas", "G107 C0 Y0 Q40. R20.", "mantle-words", LATHE),
    "a letter C": ("haas", "G107 C0 Y0 R20.\nG1 C5. F100.", "face-code", LATHE),
    "no diameter": ("siemens", "TRACYL", "code-not-supported", LATHE),
    "more arguments": ("siemens", "TRACYL(40,2)", "code-not-supported", LATHE),
    "a diameter of 0": ("siemens", "TRACYL(0)", "value-out-of-range", LATHE),
    "a wall offset": ("siemens", "TRACYL(40)\nOFFN=2", "code-not-supported", LATHE),
    "no lathe": ("siemens", "TRACYL(40)", "code-not-supported", MILL),
    "a length": ("fanuc", "G7.1 A20.\nG43 H1", "face-code", MILL),
    "the axis across": ("fanuc", "G7.1 A20.\nG1 Y5. F100.", "face-code", MILL),
}  # fmt: skip


@pytest.mark.parametrize("name", ERRORS)
def test_errors(name: str) -> None:
    dialect, source, code, axes = ERRORS[name]
    start = "" if dialect == "siemens" or axes == MILL else "G98 G97 S600 M3\n"
    with pytest.raises(GcodeError) as caught:
        run(f"{start}{source}\nM30", **options(dialect, axes))
    assert caught.value.diagnostic.code == code
