"""SINUMERIK's CYCLE93, CYCLE94 and CYCLE96: contours of the standards by hand, stock, errors."""

from __future__ import annotations

import cmath
import math
from itertools import pairwise

import numpy as np
import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.model.blocks import ArcFeed, Polyline
from cnc.model.diagnostics import Diagnostic, GcodeError
from tests.support.gcode.gcode_cases import block_summaries, run
from tests.support.soak import share

START = "T1 D1\nG18 G90 G95 G97 S600 M4 DIAMON F0.1\nG0 X50 Z5\n"
WIDE = START.replace("X50", "X120")
INSIDE = START.replace("X50", "X10")


def options(nose: float = 0.0, orientation: int = 2, width: float = 3.0) -> dict[str, object]:
    """A lathe with one tool; orientations count as LinuxCNC's: 2 is right-hand, outside."""
    return {
        "dialect": dialects.load("siemens"),
        "axes": ("x", "z"),
        "policy": ReadingPolicy(tool_widths={1: width} if width else {}),
        "lathe": True,
        "tools": ToolTable([ToolEntry(1, 1, {}, 2.0 * nose, orientation=orientation)]),
    }


def summaries(source: str, start: str = START, **given: object) -> list[str]:
    """The moves behind the first traverse, as text."""
    found = block_summaries(f"{start}{source}\nM30\n", **options(**given))  # type: ignore[arg-type]
    return found[3:-2]


def path(source: str, start: str = START, **given: object) -> np.ndarray:
    """Dense points (n,) z + jx of the feed moves of a cycle, x a radius."""
    here, points = 0j, [np.empty(0, complex)]
    shares = np.linspace(0.0, 1.0, 400)
    for block in run(f"{start}{source}\nM30\n", **options(**given)):  # type: ignore[arg-type]
        if isinstance(block, Polyline):
            for (x, z), feed in zip(block.points.tolist(), block.feeds.tolist(), strict=True):
                end = complex(z, x)
                if not math.isnan(feed):
                    points.append(here + shares * (end - here))
                here = end
        elif isinstance(block, ArcFeed):
            centre = complex(*block.center)
            points.append(centre + (here - centre) * np.exp(1j * math.tau * block.turns * shares))
            here = complex(block.end[1], block.end[0])
    return np.concatenate(points)


# Undercuts.

DIN_509 = {
    3: (0.2, 0.1, 1.0, 0.1, 0.9),
    4: (0.4, 0.2, 2.0, 0.1, 1.1),
    10: (0.4, 0.2, 2.0, 0.1, 1.1),
    14: (0.6, 0.2, 2.0, 0.1, 1.4),
    20: (0.6, 0.3, 2.5, 0.2, 2.1),
    80: (0.6, 0.3, 2.5, 0.2, 2.1),
    100: (1.0, 0.4, 4.0, 0.3, 3.2),
}
"""r, t1, f, t2 and g by a diameter: a table of DIN 509, usual stress."""


def round_(number: float) -> str:
    return f"{round(number, 6):.10g}"


@pytest.mark.parametrize("diameter", DIN_509)
def test_form_e_of_din_509(diameter: int) -> None:
    radius, depth, width, _, _ = DIN_509[diameter]
    x, low = diameter / 2, diameter / 2 - depth
    foot = -30 + width - depth / math.tan(math.radians(15))
    assert summaries(f'CYCLE94({diameter},-30,"E")', WIDE) == [
        f"rapid 60 {round_(width - 30)}", f"rapid {round_(x + 1)} {round_(width - 30)}",
        f"line {round_(x)} {round_(width - 30)} F60", f"line {round_(low)} {round_(foot)} F60",
        f"line {round_(low)} {round_(radius - 30)} F60",
        f"arc zx {round_(radius - 30)} {round_(low + radius)} {round_(low + radius)} -30 "
        f"{round_(radius)} -0.25 60",
        f"rapid {round_(x + 1)} {round_(width - 30)}",
    ]  # fmt: skip


@pytest.mark.parametrize("diameter", DIN_509)
def test_form_f_reaches_as_far_up_the_face_as_the_standard_says(diameter: int) -> None:
    _, depth, _, deep, height = DIN_509[diameter]
    places = path(f'CYCLE94({diameter},-30,"F")', WIDE)
    assert places.real.min() == pytest.approx(-30 - deep, abs=1e-5)
    low = diameter / 2 - depth
    assert places.imag.min() == pytest.approx(low, abs=1e-6)
    last = places[-1]
    assert last.real == pytest.approx(-30)
    # The table rounds g, the height of the run-out above the base, to a tenth.
    assert last.imag - low == pytest.approx(height, abs=0.06)
    slope = places[-1] - places[-200]
    assert math.degrees(math.atan2(slope.real, slope.imag)) == pytest.approx(8.0)


def contour_of(form: str) -> np.ndarray:
    """Dense points of the undercut at a cylinder of 20 mm and a face at z 0, by its drawing."""
    radius, depth, width, deep = 0.6, 0.3, 2.5, 0.2 if form == "F" else 0.0
    foot = complex(width - depth / math.tan(math.radians(15)), 10 - depth)
    centre = complex(radius - deep, 10 - depth + radius)
    end = 180.0 - (8.0 if form == "F" else 0.0)
    arc = centre + radius * np.exp(1j * np.radians(np.linspace(270.0, end, 2000)))
    corners = [complex(width, 10), foot, complex(centre.real, foot.imag)]
    if form == "F":
        corners.append(complex(arc[-1].real, arc[-1].imag))
        top = arc[-1] + abs(arc[-1].real) / math.sin(math.radians(8)) * cmath.rect(
            1, math.radians(82)
        )
        corners.append(top)
    parts = [np.linspace(a, b, 2000) for a, b in pairwise(corners[:3])]
    parts += [arc, *(np.linspace(a, b, 2000) for a, b in pairwise(corners[3:]))]
    return np.concatenate(parts)


@pytest.mark.parametrize("form", ["E", "F"])
@pytest.mark.parametrize("nose", [0.2, 0.4, 0.6])
@pytest.mark.parametrize(
    ("orientation", "z", "x"), [(2, -1, -1), (1, 1, -1), (3, -1, 1), (4, 1, 1)]
)
def test_the_nose_follows_the_undercut(
    form: str, nose: float, orientation: int, z: int, x: int
) -> None:
    start = START if x < 0 else INSIDE
    tip = path(f'CYCLE94(20,0,"{form}")', start, nose=nose, orientation=orientation)
    centre = tip - nose * complex(z, x)
    # As an undercut outside whose face is on the left.
    seen = -z * centre.real + 1j * (10.0 - x * (centre.imag - 10.0))
    contour = contour_of(form)
    distances = np.abs(seen[:, None] - contour[None, ::4])
    assert distances.min() > nose - 1e-4
    # In the flat corner of 15 degrees a round nose leaves nose * (1 / cos 7.5 - 1).
    assert distances.min(axis=0).max() < nose * (1.0 / math.cos(math.radians(7.5))) + 1e-3


def test_the_edge_position_may_be_given() -> None:
    assert summaries('CYCLE94(20,-30,"E",3)') == summaries('CYCLE94(20,-30,"e")')


M20 = {"A": (5.6, 8.7), "B": (3.2, 6.3)}
"""Width of the base and of the whole; the diameter is 3.6 mm smaller, the radius 1.2 mm."""


@pytest.mark.parametrize("form", M20)
def test_an_external_undercut_of_din_76(form: str) -> None:
    base, most = M20[form]
    found = path(f'CYCLE96(20,-30,"{form}")')
    assert found.imag.min() == pytest.approx(8.2)
    top = found[np.argmin(np.abs(found.imag - 10.0))]
    assert base < top.real + 30.0 <= most + 1e-9
    # The slope of at least 30 degrees meets the base where the width of the base ends.
    slope = 1.8 / (top.real + 30.0 - base)
    assert slope == pytest.approx(max(math.tan(math.radians(30)), 1.8 / (most - base)))
    flat = found[np.abs(found.imag - 8.2) < 1e-9]
    tangent = 1.2 * math.tan(math.atan(slope) / 2)
    assert flat.real.min() == pytest.approx(-30 + 1.2)
    assert flat.real.max() == pytest.approx(-30 + base - tangent)
    assert found[-1] == pytest.approx(complex(-30, 9.4))


def test_an_internal_undercut_of_din_76() -> None:
    found = path('CYCLE96(20,-30,"C")', INSIDE, orientation=3)
    # The minor diameter of M20 is 17.294 mm, that of the undercut 20.5 mm; base 10, whole 13 mm.
    assert found.imag.max() == pytest.approx(10.25)
    start = found[np.argmin(np.abs(found.imag - 17.294 / 2))]
    depth = 10.25 - 17.294 / 2
    assert start.real == pytest.approx(-20 + depth / math.tan(math.radians(30)), abs=1e-3)
    assert start.real < -17.0
    assert found[-1] == pytest.approx(complex(-30, 10.25 - 1.2))


@pytest.mark.parametrize("size", [3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 30, 36, 42, 48, 56, 64, 68])
@pytest.mark.parametrize("form", "ABCD")
def test_every_size_has_a_flat_base_within_the_whole(size: int, form: str) -> None:
    outside = form in "AB"
    start = START.replace("X50", "X90") if outside else START.replace("X50", "X2")
    found = path(f'CYCLE96({size},-30,"{form}")', start, orientation=2 if outside else 3)
    base = found.imag.min() if outside else found.imag.max()
    flat = found[np.abs(found.imag - base) < 1e-9]
    assert flat.real.max() > flat.real.min()


# Grooves.

PLAIN = "CYCLE93(40,-20,3,5,,,,,,,,,,2,0.5,5)"
GROOVES = {
    "one plunge, by infeeds": (
        PLAIN,
        [
            "rapid 25 -23", "rapid 21 -23", "line 18 -23 F60", "rapid 19 -23", "line 16 -23 F60",
            "rapid 17 -23", "line 15 -23 F60", "dwell 0.5", "rapid 21 -23",
        ],
    ),
    "VRT, from the left": (
        "CYCLE93(40,-23,3,5,,,,,,,,,,2,,1,0.5)",
        [
            "rapid 25 -23", "rapid 20.5 -23", "line 18 -23 F60", "rapid 18.5 -23",
            "line 16 -23 F60", "rapid 16.5 -23", "line 15 -23 F60", "rapid 20.5 -23",
        ],
    ),
    "three plunges of at most 95 % of the width": (
        "CYCLE93(40,-20,8,2,,,,,,,,,,2,,5)",
        [
            "rapid 25 -23", "rapid 21 -23", "line 18 -23 F60", "rapid 21 -23", "rapid 21 -25.5",
            "line 18 -25.5 F60", "rapid 21 -25.5", "rapid 21 -28", "line 18 -28 F60",
            "rapid 21 -28", "rapid 21 -23",
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", GROOVES)
def test_grooves(name: str) -> None:
    source, expected = GROOVES[name]
    assert summaries(source) == expected


def test_a_groove_inside() -> None:
    found = summaries("CYCLE93(40,-20,3,5,,,,,,,,,,5,,7)", INSIDE, orientation=3)
    assert found == ["rapid 5 -23", "rapid 19 -23", "line 25 -23 F60", "rapid 19 -23"]


def test_the_point_of_the_tool_may_be_its_other_edge() -> None:
    found = summaries(PLAIN, orientation=1)
    assert found == [move.replace("-23", "-20") for move in GROOVES["one plunge, by infeeds"][1]]


class Stock:
    """The bottom of a groove in z -20 to -28, as the tool leaves it; x along a grid of z."""

    def __init__(self, source: str, nose: float, orientation: int) -> None:
        self.z = np.arange(-30.0, -18.0, 0.01)
        self.x = np.full(len(self.z), 20.0)
        tip = path(source, nose=nose, orientation=orientation)
        left = tip.real - (3.0 if orientation == 1 else 0.0)
        for edge, low in zip(left.tolist(), tip.imag.tolist(), strict=True):
            some = slice(*np.searchsorted(self.z, (edge, edge + 3.0)))
            inner = np.minimum(self.z[some] - edge, edge + 3.0 - self.z[some])
            round_part = np.maximum(nose - inner, 0.0)
            bottom = low + nose - np.sqrt(np.maximum(nose**2 - round_part**2, 0.0))
            self.x[some] = np.minimum(self.x[some], bottom)


def corner(z: np.ndarray, outer: float, inner: float) -> np.ndarray:
    """Height above the base of 5 mm at distances from the wall; a chamfer is negative."""
    high = np.where(z < 0.0, 5.0, 0.0)
    if outer > 0.0:
        rounded = np.sqrt(np.maximum(outer**2 - (z + outer) ** 2, 0.0))
        high = np.where((z < 0.0) & (z > -outer), 5.0 - outer + rounded, high)
    elif outer < 0.0:
        high = np.where((z < 0.0) & (z > outer), 5.0 - (z - outer), high)
    if inner > 0.0:
        fillet = inner - np.sqrt(np.maximum(inner**2 - (inner - z) ** 2, 0.0))
        high = np.where((z >= 0.0) & (z < inner), fillet, high)
    elif inner < 0.0:
        high = np.where((z >= 0.0) & (z < -inner), -inner - z, high)
    return high


CORNERS = {
    "sharp, with allowances": (0.0, 0.0, 0.0, 0.0),
    "rounds": (0.5, 0.8, 0.5, 1.2),
    "chamfers": (-0.5, -0.7, -1.0, -0.4),
    "mixed": (0.6, -0.6, -0.8, 0.8),
}


NOSES, ORIENTATIONS, RESTS = (0.0, 0.2, 0.5), (1, 2), ("0.3,0.2", "0,0")
LEFT = [
    (name, NOSES[(k + m + n + turn) % 3], orientation, rest)
    for k, name in enumerate(CORNERS)
    for m, orientation in enumerate(ORIENTATIONS)
    for n, rest in enumerate(RESTS)
    for turn in range(share(3, 1))
]


@pytest.mark.parametrize(("name", "nose", "orientation", "rest"), LEFT)
def test_the_groove_that_is_left(name: str, nose: float, orientation: int, rest: str) -> None:
    outer1, outer2, inner1, inner2 = CORNERS[name]
    source = f"CYCLE93(40,-20,8,5,,,,{outer1},{outer2},{inner1},{inner2},{rest},2,,15)"
    stock = Stock(source, nose, orientation)
    right = corner(-20.0 - stock.z, outer1, inner1)
    left = corner(stock.z + 28.0, outer2, inner2)
    wanted = 15.0 + np.maximum(right, left)
    # A column of the grid beside a wall may be of either side.
    ok = np.minimum(np.abs(stock.z + 20.0), np.abs(stock.z + 28.0)) > 0.011
    assert (stock.x - wanted)[ok].min() > -0.003
    # A nose leaves its own round in sharp corners and at the ends of chamfers.
    steep = 0.02 + 0.6 * nose
    near = np.minimum(np.abs(stock.z + 20.0), np.abs(stock.z + 28.0)) < nose + 1.05
    assert (stock.x - wanted)[ok & ~near].max() < 0.003
    assert (stock.x - wanted)[ok].max() < steep + 0.2 * nose


def test_roughing_leaves_the_allowances() -> None:
    # The passes before the two of the contour stay 0.3 above the base and 0.2 off the walls.
    moves = summaries("CYCLE93(40,-20,8,5,,,,,,,,0.3,0.2,5,,5)")
    deep = [move for move in moves if move.startswith("line 15.3 ")]
    assert [float(move.split()[2]) for move in deep] == [-23.2, -25.5, -27.8]
    assert [move for move in moves if move.startswith("line 15 ")] == [
        "line 15 -23 F60", "line 15 -25.5 F60", "line 15 -28 F60", "line 15 -25.5 F60",
    ]  # fmt: skip


def test_chamfers_of_vari_5_are_measured_along_the_chamfer() -> None:
    length = math.sqrt(2.0)
    source = "CYCLE93(40,-20,8,5,,,,{0},{0},,,,,5,,{1})"
    assert summaries(source.format(-length, 5)) == summaries(source.format(-1, 15))


def test_the_size_of_an_undercut_is_noted() -> None:
    notes: list[Diagnostic] = []
    text = f'{START}CYCLE94(20,-30,"F")\nCYCLE96(20,-30,"B")\nM30\n'
    block_summaries(text, warn=notes.append, **options(nose=0.4))
    found = [note for note in notes if note.code == "undercut-size"]
    assert [note.severity for note in found] == ["note", "note"]
    assert "F 0.6 x 0.3 of DIN 509" in found[0].message
    assert "form B of DIN 76 for M20 x 2.5" in found[1].message


ERRORS: dict[str, tuple[str, str, dict[str, object]]] = {
    "no width": (PLAIN, "tool-width-missing", {"width": 0.0}),
    "no edge position": (PLAIN, "tool-edge", {"orientation": 0}),
    "an edge in the middle": ('CYCLE94(20,0,"E")', "tool-edge", {"orientation": 6}),
    "an edge for inside": (PLAIN, "tool-edge", {"orientation": 3}),
    "a tool wider than the groove": (PLAIN, "value-out-of-range", {"width": 3.1}),
    "allowances of the flanks": (
        "CYCLE93(40,-20,3,5,,,,,,,,,0.1,2,,5)", "value-out-of-range", {}
    ),
    "no infeed": ("CYCLE93(40,-20,3,5,,,,,,,,,,,,5)", "cycle-word-missing", {}),
    "a face": ("CYCLE93(40,-20,3,5,,,,,,,,,,2,,6)", "code-not-supported", {}),
    "flank angles": ("CYCLE93(40,-20,3,5,,10,,,,,,,,2,,5)", "code-not-supported", {}),
    "an inclined line": ("CYCLE93(40,-20,3,5,5,,,,,,,,,2,,5)", "code-not-supported", {}),
    "no kind": ("CYCLE93(40,-20,3,5,,,,,,,,,,2,,)", "value-out-of-range", {}),
    "kind 9": ("CYCLE93(40,-20,3,5,,,,,,,,,,2,,9)", "value-out-of-range", {}),
    "no depth": ("CYCLE93(40,-20,3,,,,,,,,,,,2,,5)", "cycle-word-missing", {}),
    "a round smaller than the nose": (
        "CYCLE93(40,-20,8,5,,,,,,0.3,,,,2,,5)", "value-out-of-range", {"nose": 0.4}
    ),
    "a round that the tool does not reach": (
        "CYCLE93(40,-20,4,5,,,,,,1,,,,2,,5)", "value-out-of-range", {"nose": 0.4}
    ),
    "a wide nose": (PLAIN, "value-out-of-range", {"nose": 1.5}),
    "rounds deeper than the groove": (
        "CYCLE93(40,-20,8,2,,,,1.5,,1,,,,2,,5)", "value-out-of-range", {}
    ),
    "many infeeds": ("CYCLE93(40,-20,8,5,,,,,,,,,,0.0001,,5)", "cycle-too-long", {}),
    "radii": (f"DIAMOF\n{PLAIN}", "code-not-supported", {}),
    "in the part": (f"G0 X30\n{PLAIN}", "profile-start", {}),
    "another form": ('CYCLE94(20,0,"G")', "value-out-of-range", {}),
    "no form": ("CYCLE94(20,0)", "value-out-of-range", {}),
    "a thin cylinder": ('CYCLE94(2.9,0,"E")', "value-out-of-range", {}),
    "another position": ('CYCLE94(20,0,"E",4)', "code-not-supported", {}),
    "a nose larger than the undercut": (
        'CYCLE94(8,0,"E")', "value-out-of-range", {"nose": 0.8}
    ),
    "no metric size": ('CYCLE96(19,0,"A")', "value-out-of-range", {}),
    "inside with a tool for outside": ('CYCLE96(20,0,"C")', "tool-edge", {}),
    "compensation": (f"G1 G42 X45\n{PLAIN}", "compensation-active", {"nose": 0.4}),
}  # fmt: skip


@pytest.mark.parametrize("name", ERRORS)
def test_errors(name: str) -> None:
    source, code, given = ERRORS[name]
    with pytest.raises(GcodeError) as caught:
        summaries(source, **given)
    assert caught.value.diagnostic.code == code


def test_a_tool_is_needed() -> None:
    with pytest.raises(GcodeError) as caught:
        block_summaries(f"{START[6:]}{PLAIN}\nM30\n", **options())
    assert caught.value.diagnostic.code == "tool-edge"
