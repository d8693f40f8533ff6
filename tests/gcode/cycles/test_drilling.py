"""Programs with canned cycles: blocks computed by hand for every word and mode, and errors."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import (
    block_summaries,
    error_of,
)

BEGIN = "G21 F600 S1000 M3\nG0 X1 Y2 Z3\n"
STARTED = ["spindle cw 1000", "rapid 1 2 3"]


def hole(x: float, y: float, start: float, top: float, bottom: float, end: float) -> list[str]:
    """A drilled hole: across at the height where the tool is, to R, down, and out."""
    moves = [f"rapid {x:g} {y:g} {start:g}"]
    moves += [f"rapid {x:g} {y:g} {top:g}"] if top != start else []
    return [*moves, f"line {x:g} {y:g} {bottom:g} F600", f"rapid {x:g} {y:g} {end:g}"]


PROGRAMS: dict[str, tuple[str, list[str]]] = {
    # the levels
    "G98 ends at the level before": ("G98 G81 X4 Y5 Z-1 R1", hole(4, 5, 3, 1, -1, 3)),
    "G99 ends at R": ("G99 G81 X4 Y5 Z-1 R1", hole(4, 5, 3, 1, -1, 1)),
    "the initial level is that of the series": (
        "G99 G81 X4 Y5 Z-1 R1\nG98 X5",
        hole(4, 5, 3, 1, -1, 1) + hole(5, 5, 1, 1, -1, 3),
    ),
    "another cycle goes on with the level": (
        "G99 G81 X4 Y5 Z-1 R1\nG98 G82 X5 Z-1 R1 P0",
        hole(4, 5, 3, 1, -1, 1) + hole(5, 5, 1, 1, -1, 3),
    ),
    "a traverse begins a new series": (
        "G98 G81 X4 Y5 Z-1 R1\nG0 Z7\nG81 X5 Z-1 R1",
        hole(4, 5, 3, 1, -1, 3) + ["rapid 4 5 7"] + hole(5, 5, 7, 1, -1, 7),
    ),
    "G98 below R ends at R": (
        "G0 Z0\nG98 G81 X4 Y5 Z-1 R1",
        ["rapid 1 2 0", "rapid 1 2 1"] + hole(4, 5, 1, 1, -1, 1),
    ),
    # words that stay
    "Z and R stay": (
        "G98 G81 X4 Y5 Z-1 R1\nX5\nG81 Y6",
        hole(4, 5, 3, 1, -1, 3) + hole(5, 5, 3, 1, -1, 3) + hole(5, 6, 3, 1, -1, 3),
    ),
    "a new Z stays": (
        "G98 G81 X4 Y5 Z-1 R1\nZ-2\nX5",
        hole(4, 5, 3, 1, -1, 3) + hole(4, 5, 3, 1, -2, 3)[1:] + hole(5, 5, 3, 1, -2, 3),
    ),
    "a new R stays": (
        "G98 G81 X4 Y5 Z-1 R1\nX5 R2\nX6",
        hole(4, 5, 3, 1, -1, 3) + hole(5, 5, 3, 2, -1, 3) + hole(6, 5, 3, 2, -1, 3),
    ),
    "P stays": (
        "G98 G82 X4 Y5 Z-1 R1 P0.5\nX5\nX6 P2",
        ["rapid 4 5 3", "rapid 4 5 1", "line 4 5 -1 F600", "dwell 0.5", "rapid 4 5 3"]
        + ["rapid 5 5 3", "rapid 5 5 1", "line 5 5 -1 F600", "dwell 0.5", "rapid 5 5 3"]
        + ["rapid 6 5 3", "rapid 6 5 1", "line 6 5 -1 F600", "dwell 2", "rapid 6 5 3"],
    ),
    "Q stays": (
        "G99 G73 X4 Y5 Z-1 R1 Q1.5\nX5",
        [
            "rapid 4 5 3",
            "rapid 4 5 1",
            "line 4 5 -0.5 F600",
            "rapid 4 5 -0.246",
            "line 4 5 -1 F600",
            "rapid 4 5 1",
        ]
        + [
            "rapid 5 5 1",
            "line 5 5 -0.5 F600",
            "rapid 5 5 -0.246",
            "line 5 5 -1 F600",
            "rapid 5 5 1",
        ],
    ),
    "what stays is read in the units of its line": (
        "G99 G81 X4 Y5 Z-1 R1\nG20 X0",
        [
            *hole(4, 5, 3, 1, -1, 1),
            "rapid 4 5 25.4",
            "rapid 0 5 25.4",
            "line 0 5 -25.4 F600",
            "rapid 0 5 25.4",
        ],
    ),
    "only the dwell of a tap may be left out": (
        "G99 G84 X4 Y5 Z-1 R1",
        [
            "rapid 4 5 3",
            "rapid 4 5 1",
            "overrides false false",
            "line 4 5 -1 F600",
            "spindle off 0",
            "spindle ccw 1000",
            "line 4 5 1 F600",
        ]
        + ["spindle off 0", "spindle cw 1000", "overrides true true"],
    ),
    # repeats and G91
    "L under G90 drills again": (
        "G99 G81 X4 Y5 Z-1 R1 L2",
        hole(4, 5, 3, 1, -1, 1) + hole(4, 5, 1, 1, -1, 1)[1:],
    ),
    "L under G91 goes on": (
        "G91 G98 G81 X4 Y5 Z-0.6 R1.8 L3",
        ["rapid 1 2 4.8"]
        + hole(5, 7, 4.8, 4.8, 4.2, 4.8)
        + hole(9, 12, 4.8, 4.8, 4.2, 4.8)
        + hole(13, 17, 4.8, 4.8, 4.2, 4.8),
    ),
    "under G91 R counts from the level of the series": (
        "G91 G99 G81 X4 Z-0.5 R-1 L2\nX1",
        hole(5, 2, 3, 2, 1.5, 2) + hole(9, 2, 2, 2, 1.5, 2) + hole(10, 2, 2, 2, 1.5, 2),
    ),
    "L does not stay": (
        "G91 G99 G81 X1 Z-1 R-1 L2\nX1",
        hole(2, 2, 3, 2, 1, 2) + hole(3, 2, 2, 2, 1, 2) + hole(4, 2, 2, 2, 1, 2),
    ),
    # planes
    "G18 drills along Y": (
        "G18 G98 G81 X4 Y-5 Z-0.6 R1",
        ["rapid 4 2 -0.6", "rapid 4 1 -0.6", "line 4 -5 -0.6 F600", "rapid 4 2 -0.6"],
    ),
    "G19 drills along X": (
        "G19 G99 G81 X-4 Y5 Z0 R0.5",
        ["rapid 1 5 0", "rapid 0.5 5 0", "line -4 5 0 F600", "rapid 0.5 5 0"],
    ),
    # offsets
    "the coordinate system moves everything": (
        "G10 L2 P1 X10 Z-20\nG99 G81 X4 Y5 Z-1 R1",
        ["rapid 14 5 3", "rapid 14 5 -19", "line 14 5 -21 F600", "rapid 14 5 -19"],
    ),
    "a rotated coordinate system turns the plane": (
        "G10 L2 P1 R90\nG99 G81 X4 Y5 Z-1 R1\nX6",
        [
            "rapid -5 4 3",
            "rapid -5 4 1",
            "line -5 4 -1 F600",
            "rapid -5 4 1",
            "rapid -5 6 1",
            "line -5 6 -1 F600",
            "rapid -5 6 1",
        ],
    ),
    "G20": (
        "G20 F10\nG99 G83 X0 Y0 Z-0.5 R0.1 Q0.4",
        [
            "rapid 0 0 3",
            "rapid 0 0 2.54",
            "line 0 0 -7.62 F254",
            "rapid 0 0 2.54",
            "rapid 0 0 -7.366",
            "line 0 0 -12.7 F254",
            "rapid 0 0 2.54",
        ],
    ),
    # what ends a cycle
    "G80 with a traverse": (
        "G99 G81 X4 Y5 Z-1 R1\nG80 G0 X9",
        [*hole(4, 5, 3, 1, -1, 1), "rapid 9 5 1"],
    ),
    "a traverse after a cycle": (
        "G99 G81 X4 Y5 Z-1 R1\nG0 X9",
        [*hole(4, 5, 3, 1, -1, 1), "rapid 9 5 1"],
    ),
    "M-codes between two holes": (
        "G99 G81 X4 Y5 Z-1 R1\nM8\nX5",
        [*hole(4, 5, 3, 1, -1, 1), "coolant false true", *hole(5, 5, 1, 1, -1, 1)],
    ),
    "a feed in the line": (
        "G99 G81 X4 Y5 Z-1 R1 F120",
        ["rapid 4 5 3", "rapid 4 5 1", "line 4 5 -1 F120", "rapid 4 5 1"],
    ),
    "a feed a turn": (
        "G95 F0.1\nG99 G81 X4 Y5 Z-1 R1",
        ["rapid 4 5 3", "rapid 4 5 1", "line 4 5 -1 F100", "rapid 4 5 1"],
    ),
    # every cycle once
    "G74": (
        "M4\nG98 G74 X4 Y5 Z-1 R1 P0.5",
        [
            "spindle ccw 1000",
            "rapid 4 5 3",
            "rapid 4 5 1",
            "overrides false false",
            "line 4 5 -1 F600",
            "spindle off 0",
            "spindle cw 1000",
            "dwell 0.5",
        ]
        + ["line 4 5 3 F600", "spindle off 0", "spindle ccw 1000", "overrides true true"],
    ),
    "a tap leaves the overrides as they were": (
        "M51 P0\nG99 G84 X4 Y5 Z-1 R1",
        [
            "overrides true false",
            "rapid 4 5 3",
            "rapid 4 5 1",
            "overrides false false",
            "line 4 5 -1 F600",
            "spindle off 0",
            "spindle ccw 1000",
        ]
        + ["line 4 5 1 F600", "spindle off 0", "spindle cw 1000", "overrides true false"],
    ),
    "G85": (
        "G98 G85 X4 Y5 Z-1 R1",
        ["rapid 4 5 3", "rapid 4 5 1", "line 4 5 -1 F600", "line 4 5 1 F600", "rapid 4 5 3"],
    ),
    "G86": (
        "G98 G86 X4 Y5 Z-1 R1 P0.5",
        [
            "rapid 4 5 3",
            "rapid 4 5 1",
            "line 4 5 -1 F600",
            "dwell 0.5",
            "spindle off 0",
            "rapid 4 5 3",
            "spindle cw 1000",
        ],
    ),
    "G88": (
        "G98 G88 X4 Y5 Z-1 R1 P0.5",
        [
            "rapid 4 5 3",
            "rapid 4 5 1",
            "line 4 5 -1 F600",
            "dwell 0.5",
            "spindle off 0",
            "stop",
            "rapid 4 5 3",
            "spindle cw 1000",
        ],
    ),
    "G89": (
        "G98 G89 X4 Y5 Z-1 R1 P0.5",
        ["rapid 4 5 3", "rapid 4 5 1", "line 4 5 -1 F600", "dwell 0.5", "line 4 5 3 F600"],
    ),
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_drills_its_holes(name: str) -> None:
    source, expected = PROGRAMS[name]
    assert block_summaries(BEGIN + source) == STARTED + expected


FANUC: dict[str, tuple[str, list[str]]] = {
    "words stay from cycle to cycle": (
        "G98 G81 X4. Y5. Z-1. R1.\nG85 X5.",
        hole(4, 5, 3, 1, -1, 3)
        + ["rapid 5 5 3", "rapid 5 5 1"]
        + ["line 5 5 -1 F600", "line 5 5 1 F600", "rapid 5 5 3"],
    ),
    "R alone drills again": (
        "G98 G81 X4. Y5. Z-1. R1.\nR2.",
        hole(4, 5, 3, 1, -1, 3) + hole(4, 5, 3, 2, -1, 3)[1:],
    ),
    "until G80": (
        "G98 G81 X4. Y5. Z-1. R1.\nG80\nG81 X5. Z-2. R1.",
        hole(4, 5, 3, 1, -1, 3) + hole(5, 5, 3, 1, -2, 3),
    ),
    "the level of the series is the default": ("G81 X4. Y5. Z-1. R1.", hole(4, 5, 3, 1, -1, 3)),
    "K repeats, P is in milliseconds": (
        "G91 G99 G82 X1. Z-1. R-1. P500 K2",
        ["rapid 2 2 3", "rapid 2 2 2", "line 2 2 1 F600", "dwell 0.5", "rapid 2 2 2"]
        + ["rapid 3 2 2", "line 3 2 1 F600", "dwell 0.5", "rapid 3 2 2"],
    ),
    "the dwell may be left out": ("G99 G82 X4. Y5. Z-1. R1.", hole(4, 5, 3, 1, -1, 1)),
    "G83": (
        "G99 G83 X4. Y5. Z-1. R1. Q1.5",
        [
            "rapid 4 5 3",
            "rapid 4 5 1",
            "line 4 5 -0.5 F600",
            "rapid 4 5 1",
            "rapid 4 5 0",
            "line 4 5 -1 F600",
            "rapid 4 5 1",
        ],
    ),
    "G84 dwells before each reversal and traverses above R": (
        "G84 X4. Y5. Z-1. R1. P250",
        [
            "rapid 4 5 3",
            "rapid 4 5 1",
            "overrides false false",
            "line 4 5 -1 F600",
            "dwell 0.25",
            "spindle off 0",
            "spindle ccw 1000",
        ]
        + [
            "line 4 5 1 F600",
            "dwell 0.25",
            "spindle off 0",
            "spindle cw 1000",
            "overrides true true",
            "rapid 4 5 3",
        ],
    ),
    "G89 feeds to R": (
        "G89 X4. Y5. Z-1. R1. P250",
        [
            "rapid 4 5 3",
            "rapid 4 5 1",
            "line 4 5 -1 F600",
            "dwell 0.25",
            "line 4 5 1 F600",
            "rapid 4 5 3",
        ],
    ),
    "G76 bores finely": (
        "G76 X4. Y5. Z-1. R1. Q0.1 P250",
        [
            "rapid 4 5 3",
            "rapid 4 5 1",
            "line 4 5 -1 F600",
            "dwell 0.25",
            "spindle off 0",
            "orient 0",
            "rapid 4.1 5 -1",
            "rapid 4.1 5 3",
        ]
        + ["rapid 4 5 3", "spindle cw 1000"],
    ),
    "G76 in G19 shifts along Y": (
        "G19 G99 G76 X-1. Y5. Z3. R0.5 Q0.1",
        [
            "rapid 1 5 3",
            "rapid 0.5 5 3",
            "line -1 5 3 F600",
            "spindle off 0",
            "orient 0",
            "rapid -1 5.1 3",
            "rapid 0.5 5.1 3",
        ]
        + ["rapid 0.5 5 3", "spindle cw 1000"],
    ),
}


@pytest.mark.parametrize("name", FANUC)
def test_fanuc(name: str) -> None:
    source, expected = FANUC[name]
    assert (
        block_summaries("G21 F600. S1000 M3\nG0 X1. Y2. Z3.\n" + source, dialect="fanuc")
        == STARTED + expected
    )


def test_the_default_retract_level_by_dialect() -> None:
    source = BEGIN + "G81 X4 Y5 Z-1 R1"
    assert block_summaries(source + "\nM2", dialect="linuxcnc")[:6] == STARTED + hole(
        4, 5, 3, 1, -1, 1
    )
    assert block_summaries(source) == STARTED + hole(4, 5, 3, 1, -1, 3)


def test_a_lathe_drills_along_its_axis() -> None:
    """Two axes are enough for a hole in the middle."""
    assert block_summaries("F600\nG0 X2 Z3\nG98 G81 X0 Z-1 R1", axes=("x", "z")) == [
        "rapid 2 3", "rapid 0 3", "rapid 0 1", "line 0 -1 F600", "rapid 0 3",
    ]  # fmt: skip


def test_no_feed_and_no_axis() -> None:
    assert error_of("G81 X1 Z-1 R1").code == "feed-missing"
    assert error_of("F60 G18\nG81 X1 Z-1 R1", axes=("x", "z")).code == "axis-missing"


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_rotary_axes_turn_before_each_hole(dialect: str) -> None:
    """They turn with the move to the hole, at R or above, and never while the tool goes down."""
    repeats = "K" if dialect == "fanuc" else "L"
    program = (
        "G21 G90 F600. S1000 M3\nG0 X1. Y2. Z0. C0.\nG99 G81 X4. Y5. Z-1. R1. C30.\nC60.\n"
        f"G98 X5. C90.\nG80 G0 Z3.\nG91 G99 G81 X2. Z-2. R-1. C-15. {repeats}2\nG90 G80\nM30"
    )
    found = block_summaries(program, dialect=dialect, axes=("x", "y", "z", "c"))
    expected = ["spindle cw 1000", "rapid 1 2 0 0", "rapid 1 2 1 0"]
    for x, turned, top, bottom, end in (
        (4, 30, 1, -1, 1), (4, 60, 1, -1, 1), (5, 90, 1, -1, 1)
    ):  # fmt: skip
        expected += [f"rapid {x} 5 {top} {turned}", f"line {x} 5 {bottom} {turned} F600"]
        expected += [f"rapid {x} 5 {end} {turned}"]
    expected += ["rapid 5 5 3 90", "rapid 7 5 3 75", "rapid 7 5 2 75", "line 7 5 0 75 F600"]
    expected += ["rapid 7 5 2 75", "rapid 9 5 2 60", "line 9 5 0 60 F600", "rapid 9 5 2 60"]
    assert found[: len(expected)] == expected
    assert not [row for row in found[len(expected) :] if row.startswith(("rapid", "line"))]
