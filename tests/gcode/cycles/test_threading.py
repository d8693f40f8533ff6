"""Programs with G33, G33.1 and G76: blocks computed by hand, and errors."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import assert_error_at, block_summaries, error_of

BEGIN = "G21 F600 S600 M3\nG0 X1 Y2 Z3\n"
STARTED = ["spindle cw 600", "rapid 1 2 3"]
LATHE = "G18 G21 S600 M3\nG0 X20 Y0 Z5\n"
AT_LATHE = ["spindle cw 600", "rapid 20 0 5"]

# S600 is ten turns a second, so K1.5 is 15 mm/s, 900 mm/min.
MOVES: dict[str, tuple[str, list[str]]] = {
    "G33": ("G33 Z-1 K1.5", ["sync 1.5", "line 1 2 -1 F900", "sync 0"]),
    "K counts along the move": ("G33 X4 Z-1 K1.5", ["sync 1.5", "line 4 2 -1 F900", "sync 0"]),
    "G33 again goes on without a stop": (
        "G33 Z-1 K1.5\n(the same thread)\nX4 Z-2 K1",
        ["sync 1.5", "line 1 2 -1 F900", "line 4 2 -2 F600", "sync 0"],
    ),
    "a move between two G33 ends the first": (
        "G33 Z-1 K1.5\nG0 Z3\nG33 Z-1 K1.5",
        ["sync 1.5", "line 1 2 -1 F900", "sync 0", "rapid 1 2 3"]
        + ["sync 1.5", "line 1 2 -1 F900", "sync 0"],
    ),
    "plain moves behind G33 end it": (
        "G33 Z-1 K1.5\nG1 Z-2 F60\nZ-3\nZ-4",
        ["sync 1.5", "line 1 2 -1 F900", "sync 0"]
        + ["line 1 2 -2 F60", "line 1 2 -3 F60", "line 1 2 -4 F60"],
    ),
    "G64 is suspended for all moves of a thread": (
        "G64 P0.1\nG33 Z-1 K1.5\nX4 Z-2 K1\nG0 Z3",
        ["path blend 0.1", "path exact-path 0", "sync 1.5", "line 1 2 -1 F900", "line 4 2 -2 F600"]
        + ["sync 0", "path blend 0.1", "rapid 4 2 3"],
    ),
    "G33 under G91 and G20": (
        "G91 G20\nG33 Z-1 K0.1",
        ["sync 2.54", "line 1 2 -22.4 F1524", "sync 0"],
    ),
    "G33 in a rotated system": (
        "G10 L2 P1 R90\nG33 X4 K1.5",
        ["sync 1.5", "line 1 4 3 F900", "sync 0"],
    ),
    "G33 needs no F": ("G93\nG33 Z-1 K1.5", ["sync 1.5", "line 1 2 -1 F900", "sync 0"]),
    "G33 of no length": ("G33 Z3 K1.5", []),
    "G33.1": (
        "G33.1 Z-1 K1.5",
        [
            "sync 1.5",
            "line 1 2 -1 F900",
            "spindle ccw 600",
            "line 1 2 3 F900",
            "spindle cw 600",
            "sync 0",
        ],
    ),
    "G33.1 left-hand, back twice as fast": (
        "M4\nG33.1 Z-1 K1.5 I2",
        [
            "spindle ccw 600",
            "sync 1.5",
            "line 1 2 -1 F900",
            "spindle cw 1200",
            "line 1 2 3 F1800",
            "spindle ccw 600",
            "sync 0",
        ],
    ),
    "G33.1 goes on from its start": (
        "G33.1 Z-1 K1\nG91\nG0 Z1",
        [
            "sync 1",
            "line 1 2 -1 F600",
            "spindle ccw 600",
            "line 1 2 3 F600",
            "spindle cw 600",
            "sync 0",
            "rapid 1 2 4",
        ],
    ),
}


@pytest.mark.parametrize("name", MOVES)
def test_moves_that_follow_the_spindle(name: str) -> None:
    source, expected = MOVES[name]
    assert block_summaries(BEGIN + source) == STARTED + expected


def turning(x: float, away: float) -> list[str]:
    """A plain pass of the thread below."""
    return [
        f"rapid {x:g} 0 5",
        "sync 1.5",
        f"line {x:g} 0 -20 F900",
        "sync 0",
        f"rapid {away:g} 0 -20",
    ]


THREADS: dict[str, tuple[str, list[str]]] = {
    "an external thread of two passes": (
        "G76 P1.5 Z-20 I-1 J0.4 K0.8",
        [
            "overrides false true",
            "rapid 20.4 0 5",
            *turning(18.6, 20.4),
            "rapid 20 0 5",
            *turning(18.2, 20),
            "overrides true true",
        ],
    ),
    "an internal one": (
        "G76 P1.5 Z-20 I1 J0.4 K0.8",
        [
            "overrides false true",
            "rapid 19.6 0 5",
            *turning(21.4, 19.6),
            "rapid 20 0 5",
            *turning(21.8, 20),
            "overrides true true",
        ],
    ),
    "one pass and a spring pass": (
        "G76 P1.5 Z-20 I-1 J0.8 K0.8 H1",
        [
            "overrides false true",
            *turning(18.2, 20),
            "rapid 20 0 5",
            *turning(18.2, 20),
            "overrides true true",
        ],
    ),
    "under G91 Z is a way": (
        "G91\nG76 P1.5 Z-25 I-1 J0.8 K0.8",
        ["overrides false true", *turning(18.2, 20), "overrides true true"],
    ),
    "under G7 I J K are diameters": (
        "G7\nG76 P1.5 Z-20 I-2 J1.6 K1.6",
        ["overrides false true", *turning(18.2, 20), "overrides true true"],
    ),
    "an exit taper of 45 degrees": (
        "G76 P1.5 Z-20 I-1 J0.8 K0.8 E0.8 L2",
        [
            "overrides false true",
            "rapid 18.2 0 5",
            "sync 1.5",
            "line 18.2 0 -19.2 F900",
        ]
        + ["line 19 0 -20 F1272.792206", "sync 0", "rapid 20 0 -20", "overrides true true"],
    ),
    "an entry taper and the slide": (
        "G76 P1.5 Z-20 I-1 J0.8 K0.8 Q45 E0.8 L1",
        [
            "overrides false true",
            "rapid 20 0 4.2",
            "sync 2.12132",
            "line 19 0 4.2 F1272.792206",
            "line 18.2 0 3.4 F1272.792206",
        ]
        + ["line 18.2 0 -20 F900", "sync 0", "rapid 20 0 -20", "overrides true true"],
    ),
    "towards plus": (
        "G76 P1.5 Z30 I-1 J0.8 K0.8 Q45",
        [
            "overrides false true",
            "rapid 20 0 5.8",
            "rapid 18.2 0 5.8",
            "sync 1.5",
            "line 18.2 0 30 F900",
            "sync 0",
            "rapid 20 0 30",
        ]
        + ["overrides true true"],
    ),
}


@pytest.mark.parametrize("name", THREADS)
def test_g76(name: str) -> None:
    source, expected = THREADS[name]
    assert block_summaries(LATHE + source) == AT_LATHE + expected


def test_a_lathe_has_no_y() -> None:
    begin = "G18 G21 S600 M3\nG0 X20 Z5\n"
    assert block_summaries(begin + "G76 P1.5 Z-20 I-1 J0.8 K0.8", axes=("x", "z"))[2:5] == [
        "overrides false true",
        "rapid 18.2 5",
        "sync 1.5",
    ]
    assert block_summaries(begin + "G17 G33 X10 Z-20 K1.5", axes=("x", "z"))[2:] == [
        "sync 1.5",
        "line 10 -20 F900",
        "sync 0",
    ]
    assert (
        error_of(begin.replace("X20", "") + "G76 P1.5 Z-20 I-1 J0.8 K0.8", axes=("y", "z")).code
        == "axis-missing"
    )


WRONG: dict[str, tuple[str, str]] = {
    "G33 without axes": ("axis-words-missing", "¦G33 K1"),
    "G33 without K": ("pitch-missing", "¦G33 Z-1"),
    "K does not stay": ("pitch-missing", "G33 Z-1 K1\n¦Z-2"),
    "K zero": ("value-out-of-range", "G33 Z-1 ¦K0"),
    "K negative": ("value-out-of-range", "G33.1 Z-1 ¦K-1"),
    "G33 with a rotary axis": ("axis-not-allowed", "G33 ¦A3 K1"),
    "G33 with I": ("word-unused", "G33 Z-1 K1 ¦I2"),
    "G33 standing": ("spindle-stopped", "M5\n¦G33 Z-1 K1"),
    "G33.1 at no speed": ("spindle-stopped", "S0\n¦G33.1 Z-1 K1"),
    "G33 under G96": ("surface-speed-active", "G96 S100 D2000\n¦G33 Z-1 K1"),
    "G33.1 back at no speed": ("value-out-of-range", "G33.1 Z-1 K1 ¦I0"),
    "G33.1 back the wrong way": ("value-out-of-range", "G33.1 Z-1 K1 ¦I-1"),
    "G33 under cutter compensation": ("compensation-active", "G41.1 D1\nG1 X40 F60\n¦G33 X50 K1"),
    "G76 under cutter compensation": (
        "compensation-active",
        "G41.1 D1\nG1 X40 F60\n¦G76 P1 Z-20 I-1 J.4 K.8",
    ),
    "G33 in machine coordinates": ("machine-coordinates-motion", "¦G53 G33 Z-1 K1"),
    "G76 in G17": ("thread-plane", "G17 ¦G76 P1 Z-20 I-1 J.4 K.8"),
    "G76 with X": ("axis-not-allowed", "G76 P1 ¦X1 Z-20 I-1 J.4 K.8"),
    "G76 without Z": ("axis-words-missing", "¦G76 P1 I-1 J.4 K.8"),
    "G76 without P": ("pitch-missing", "¦G76 Z-20 I-1 J.4 K.8"),
    "G76 without I": ("cycle-word-missing", "¦G76 P1 Z-20 J.4 K.8"),
    "G76 without J": ("cycle-word-missing", "¦G76 P1 Z-20 I-1 K.8"),
    "G76 without K": ("cycle-word-missing", "¦G76 P1 Z-20 I-1 J.4"),
    "G76 again without its words": ("pitch-missing", "G76 P1 Z-20 I-1 J.4 K.8\n¦Z-21"),
    "P zero": ("value-out-of-range", "G76 ¦P0 Z-20 I-1 J.4 K.8"),
    "I zero": ("value-out-of-range", "G76 P1 Z-20 ¦I0 J.4 K.8"),
    "J zero": ("value-out-of-range", "G76 P1 Z-20 I-1 ¦J0 K.8"),
    "K less than J": ("value-out-of-range", "G76 P1 Z-20 I-1 J.4 ¦K.3"),
    "R less than 1": ("value-out-of-range", "G76 P1 Z-20 I-1 J.4 K.8 ¦R.9"),
    "R beyond sense": ("cycle-too-long", "¦G76 P1 Z-20 I-1 J.4 K.8 R50"),
    "Q a right angle": ("value-out-of-range", "G76 P1 Z-20 I-1 J.4 K.8 ¦Q90"),
    "a slide longer than the thread": ("thread-slide", "G76 P1 Z4 I-1 J.4 K.8 ¦Q60"),
    "H negative": ("value-out-of-range", "G76 P1 Z-20 I-1 J.4 K.8 ¦H-1"),
    "half a spring pass": ("value-out-of-range", "G76 P1 Z-20 I-1 J.4 K.8 ¦H1.5"),
    "L beyond 3": ("value-out-of-range", "G76 P1 Z-20 I-1 J.4 K.8 E1 ¦L4"),
    "a taper of no length": ("thread-taper", "G76 P1 Z-20 I-1 J.4 K.8 ¦L1"),
    "a taper of more than half": ("thread-taper", "G76 P1 Z-20 I-1 J.4 K.8 ¦E13 L1"),
    "E negative": ("value-out-of-range", "G76 P1 Z-20 I-1 J.4 K.8 ¦E-1 L1"),
    "no length": ("thread-length", "G76 P1 ¦Z5 I-1 J.4 K.8"),
    "G76 standing": ("spindle-stopped", "M5\n¦G76 P1 Z-20 I-1 J.4 K.8"),
    "G76 under G96": ("surface-speed-active", "G96 S100 D2000\n¦G76 P1 Z-20 I-1 J.4 K.8"),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_are_reported_at_the_word(name: str) -> None:
    code, source = WRONG[name]
    assert_error_at(code, LATHE + source, axes=("x", "y", "z", "a"))


def test_the_slide_shortens_both_tapers() -> None:
    """Drive line 10, tapers of 5 at both ends: nothing is left once the slide takes its part."""
    assert error_of(LATHE + "G76 P1 Z-5 I-1 J.4 K.8 Q30 E5 L3").code == "thread-slide"
    assert block_summaries(LATHE + "G76 P1 Z-5 I-1 J.8 K.8 E5 L3")
