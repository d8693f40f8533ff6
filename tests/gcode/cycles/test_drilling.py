"""Programs with canned cycles: blocks computed by hand for every word and mode, and errors."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.gcode.cycles.drilling_steps import Hole, HoleSettings, steps
from cnc.gcode.cycles.steps import Cut, Pause, Rapid
from tests.support.gcode.gcode_cases import (
    assert_error_at,
    assert_rows_equal,
    block_summaries,
    error_of,
    rows,
    run,
)
from tests.support.soak import share

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


WRONG: dict[str, tuple[str, str]] = {
    "no Z": ("cycle-word-missing", "¦G81 X4 R1"),
    "no R": ("cycle-word-missing", "¦G81 X4 Z-1"),
    "another cycle needs R again": ("cycle-word-missing", "G81 X4 Z-1 R1\n¦G85 X5 Z-1"),
    "another cycle needs Z again": ("cycle-word-missing", "G81 X4 Z-1 R1\n¦G85 X5 R1"),
    "R after G80": ("cycle-word-missing", "G81 X4 Z-1 R1\nG80\n¦G81 X5 Z-1"),
    "R after a traverse": ("cycle-word-missing", "G81 X4 Z-1 R1\nG0 Z9\n¦G81 X5 Z-1"),
    "another plane is another depth": ("cycle-word-missing", "G81 X4 Z-1 R1\nG18 ¦X5"),
    "Q missing": ("cycle-word-missing", "¦G83 X4 Z-1 R1"),
    "Q missing in G73": ("cycle-word-missing", "¦G73 X4 Z-1 R1"),
    "Q of another cycle": ("cycle-word-missing", "G83 X4 Z-1 R1 Q1\nG81 X5 Z-1 R1\n¦G83 X6 Z-1 R1"),
    "P missing": ("cycle-word-missing", "¦G82 X4 Z-1 R1"),
    "P missing in G86": ("cycle-word-missing", "¦G86 X4 Z-1 R1"),
    "P missing in G89": ("cycle-word-missing", "¦G89 X4 Z-1 R1"),
    "P of another cycle": ("cycle-word-missing", "G82 X4 Z-1 R1 P1\n¦G89 X5 Z-1 R1"),
    "R below Z": ("cycle-retract-below-bottom", "G81 X4 Z-1 ¦R-2"),
    "R below Z under G91": ("cycle-retract-below-bottom", "G91 G81 X4 Z1 ¦R-2"),
    "R below Z that stayed": ("cycle-retract-below-bottom", "G81 X4 Z-1 R1\nX5 ¦R-2"),
    "Q zero": ("value-out-of-range", "G83 X4 Z-1 R1 ¦Q0"),
    "Q negative": ("value-out-of-range", "G73 X4 Z-1 R1 ¦Q-1"),
    "Q next to nothing": ("cycle-too-long", "G83 X4 Z-1 R1 ¦Q1e-9".replace("1e-9", "0.000000001")),
    "P negative": ("value-out-of-range", "G82 X4 Z-1 R1 ¦P-1"),
    "P of a fortnight": ("value-out-of-range", "G82 X4 Z-1 R1 ¦P1209600"),
    "L zero": ("value-out-of-range", "G81 X4 Z-1 R1 ¦L0"),
    "L negative": ("value-out-of-range", "G81 X4 Z-1 R1 ¦L-1"),
    "half a repeat": ("value-out-of-range", "G81 X4 Z-1 R1 ¦L1.5"),
    "too many repeats": ("value-out-of-range", "G81 X4 Z-1 R1 ¦L1000000"),
    "a rotary axis": ("axis-not-allowed", "G81 X4 Z-1 R1 ¦A0"),
    "cutter compensation": ("compensation-active", "G41.1 D1\nG1 X20\n¦G81 X40 Z-1 R1"),
    "G93": ("inverse-time-active", "G93\n¦G81 X4 Z-1 R1"),
    "no axis word": ("axis-words-missing", "¦G81 R1"),
    "R alone": ("word-unused", "G81 X4 Z-1 R1\n¦R2"),
    "L alone": ("word-unused", "G81 X4 Z-1 R1\n¦L2"),
    "P without a dwell": ("word-unused", "G81 X4 Z-1 R1 ¦P1"),
    "Q without bites": ("word-unused", "G82 X4 Z-1 R1 P1 ¦Q1"),
    "machine coordinates": ("machine-coordinates-motion", "¦G53 G81 X4 Z-1 R1"),
    "G84 turning the wrong way": ("spindle-direction", "M4\n¦G84 X4 Z-1 R1"),
    "G74 turning the wrong way": ("spindle-direction", "¦G74 X4 Z-1 R1"),
    "G84 standing": ("spindle-stopped", "M5\n¦G84 X4 Z-1 R1"),
    "G84 at no speed": ("spindle-stopped", "S0\n¦G84 X4 Z-1 R1"),
    "G86 standing": ("spindle-stopped", "M5\n¦G86 X4 Z-1 R1 P1"),
    "G88 standing": ("spindle-stopped", "M5\n¦G88 X4 Z-1 R1 P1"),
    "two levels": ("modal-conflict", "G98 ¦G99"),
    "two cycles": ("modal-conflict", "G81 ¦G82 X4 Z-1 R1 P1"),
    "axis words after G80": ("motion-missing", "G81 X4 Z-1 R1\nG80\n¦X5"),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_are_reported_at_the_word(name: str) -> None:
    code, source = WRONG[name]
    assert_error_at(code, BEGIN.replace("G0", "G0 A0") + source, axes=("x", "y", "z", "a"))


@pytest.mark.parametrize(
    ("code", "source"),
    [
        ("value-out-of-range", "G81 X4. Z-1. R1. ¦K-1"),
        ("word-wanted-twice", "G81 X4. Z-1. R1. L2 ¦K2"),
        ("word-unused", "G81 X4. Z-1. R1.\n¦K2"),
        ("cycle-word-missing", "¦G76 X4. Z-1. R1."),
        ("value-out-of-range", "G76 X4. Z-1. R1. ¦Q0."),
        ("code-not-supported", "¦G87 X4. Z-1. R1. Q1."),
        ("spindle-stopped", "M5\n¦G76 X4. Z-1. R1. Q1."),
    ],
)
def test_errors_of_fanuc(code: str, source: str) -> None:
    assert_error_at(code, "G21 F600. S1000 M3\n" + source, dialect="fanuc")


def test_a_lathe_drills_along_its_axis() -> None:
    """Two axes are enough for a hole in the middle."""
    assert block_summaries("F600\nG0 X2 Z3\nG98 G81 X0 Z-1 R1", axes=("x", "z")) == [
        "rapid 2 3", "rapid 0 3", "rapid 0 1", "line 0 -1 F600", "rapid 0 3",
    ]  # fmt: skip


def test_no_feed_and_no_axis() -> None:
    assert error_of("G81 X1 Z-1 R1").code == "feed-missing"
    assert error_of("F60 G18\nG81 X1 Z-1 R1", axes=("x", "z")).code == "axis-missing"


NEEDED = {"G81": "ZR", "G82": "ZRP", "G83": "ZRQ", "G85": "ZR"}


@st.composite
def series(draw: st.DrawFn) -> list[tuple[str, str, str, dict[str, int]]]:
    """Lines of distance mode, retract mode, code and words; most of them have what their cycle
    needs.
    """
    program, current = [], ""
    for _ in range(draw(st.integers(1, 6))):
        code = draw(st.sampled_from(["", "", *NEEDED])) or ("" if current else "G81")
        begins = code not in ("", current)
        current = code or current
        words = {letter: draw(st.integers(-9, 9)) for letter in "XY" if draw(st.integers(0, 2))}
        for letter in NEEDED[current]:
            if draw(st.integers(0, 14)) if begins else not draw(st.integers(0, 4)):
                words[letter] = draw(
                    st.integers(-9, 2)
                    if letter == "Z"
                    else st.integers(-2, 9)
                    if letter == "R"
                    else st.integers(1, 4)
                )
        if not draw(st.integers(0, 3)):
            words["L"] = draw(st.integers(1, 3))
        program.append(
            (
                draw(st.sampled_from(["", "", "", "G90", "G91"])),
                draw(st.sampled_from(["", "", "G98", "G99"])),
                code,
                words,
            )
        )
    return program


def model(
    program: list[tuple[str, str, str, dict[str, int]]],
) -> Iterator[tuple[str, list[Hole], dict[str, int]]]:
    """Cycle, holes and words in effect of each line: the rules a second time, in the simplest way.
    ValueError at a wrong line.
    """
    x = y = 0.0
    level, absolute, initial, current = 5.0, True, True, ""
    known: dict[str, int] = {}
    for distance, retract, code, words in program:
        absolute = {"G90": True, "G91": False}.get(distance, absolute)
        initial = {"G98": True, "G99": False}.get(retract, initial)
        known = {} if code not in ("", current) else known
        current = code or current
        if not {"X", "Y", "Z"} & words.keys():
            if code or words:
                raise ValueError
            yield current, [], known
            continue
        known |= {letter: value for letter, value in words.items() if letter in NEEDED[current]}
        if known.keys() != set(NEEDED[current]):
            raise ValueError
        top = known["R"] + (0 if absolute else level)
        bottom = known["Z"] + (0 if absolute else top)
        if bottom > top:
            raise ValueError
        made = []
        for _ in range(words.get("L", 1)):
            x = words.get("X", x) if absolute else x + words.get("X", 0)
            y = words.get("Y", y) if absolute else y + words.get("Y", 0)
            made.append(Hole(x, y, bottom, top, max(level, top) if initial else top))
        yield current, made, known


@settings(max_examples=share(20000, 75), deadline=None)
@given(series())
def test_series_against_a_second_implementation(
    program: list[tuple[str, str, str, dict[str, int]]],
) -> None:
    text = "F600\nG0 Z5\n"
    for *codes, words in program:
        text += " ".join([*codes, *(f"{letter}{value}" for letter, value in words.items())]) + "\n"
    expected: list[tuple[object, ...]] = [("rapid", 0.0, 0.0, 5.0)]
    place = (0.0, 0.0, 5.0)
    line = 2
    try:
        for cycle, holes, known in model(program):
            line += 1
            settings = HoleSettings(
                feed=10.0, dwell=known.get("P", 0), peck=known.get("Q", 0), clearance=0.254
            )
            for step in steps(int(cycle[1:]) * 10, place, holes, settings):
                if isinstance(step, Pause):
                    expected.append(("dwell", step.seconds))
                elif isinstance(step, Rapid | Cut):
                    expected.append(
                        ("line", *step.to, 600.0) if isinstance(step, Cut) else ("rapid", *step.to)
                    )
                    place = step.to
    except ValueError:
        assert error_of(text).line == line + 1
    else:
        assert_rows_equal(list(rows(run(text))), expected)
