"""Errors of canned cycles, reported at their words."""

from __future__ import annotations

import pytest

from tests.support.gcode.gcode_cases import assert_error_at, error_of

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
    "axis words after G80": ("motion-missing", "G2 I5\nG81 X4 Z-1 R1\nG80\n¦X5"),
}


@pytest.mark.parametrize("name", WRONG)
def test_errors_are_reported_at_the_word(name: str) -> None:
    code, source = WRONG[name]
    assert_error_at(code, "G21 F600 S1000 M3\nG0 A0 X1 Y2 Z3\n" + source, axes=("x", "y", "z", "a"))


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


def test_a_cycle_that_was_not_ended_is_named() -> None:
    # M6 does not end a cycle: the height of the next tool would be the bottom of a hole.
    source = "G81 X1. Y1. Z-3. R2. F100\nM9\nG91 G28 Z0.\nT2 M6\nG90 Z25.\nM30"
    found = error_of(f"O1\nG21 G90\nG0 Z20.\n{source}", dialect="fanuc")
    assert (found.code, found.line) == ("cycle-retract-below-bottom", 8)
    assert "G81" in found.hint
    assert "G80 ends it" in found.hint
