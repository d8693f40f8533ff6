"""Programs of lathes against a second reader: ends of lines, profiles, threads, and traverses."""

from __future__ import annotations

import re

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from tests.support.gcode.gcode_cases import run
from tests.support.gcode.turning_cases import moves_of
from tests.support.gcode.turning_oracle import differences, reading_of
from tests.support.paths import ROOT

SHIPPED = ROOT / "programs" / "lathe"

SHAFT = """\
G18 G21 G40 G80 G99 G97 S600 M3
G0 X44. Z0.
G1 X-1.6 F0.15
G0 Z2.
G0 X42.
G71 U2. R0.5
G71 P10 Q20 U0.4 W0.1 F0.3
N10 G0 X14.
G1 X20. Z-1. F0.1
Z-20.
X28.
X30. Z-21.
Z-39.
G2 X32. Z-40. R1.
G1 X35.
G3 X36. Z-40.5 R0.5
G1 Z-55.
N20 X42.
G42 G0 X42. Z2.
G70 P10 Q20
G40 G0 X44. Z5.
G97 S700 M3
G0 X24. Z6.
G76 P020060 Q50 R0.05
G76 X18.16 Z-18. P920 Q300 F1.5
G0 X24. Z4.
G92 X19.2 Z-18. F1.5
X18.6
X18.16
G0 X60. Z60.
M30
"""
BORE = """\
G18 G21 G40 G80 G90 G99 G97 S600 M3
G0 X18. Z2.
G71 U1. R0.5
G71 P100 Q101 U-0.3 W0.1 F0.2
N100 G0 X40.
G1 Z0.
X36. Z-2.
Z-20.
G3 X30. Z-23. R3.
G1 X24.
N101 Z-30.
G70 P100 Q101 F0.1
G72 W1. R0.5
G72 P200 Q201 U-0.2 W0.1 F0.2
N200 G0 Z-12.
G1 X36.
N201 X40. Z-10.
G0 Z50.
M30
"""
SHAFT_OF_A_HAAS = """\
G18 G21 G40 G80 G99 G97 S600 M3
G0 X42. Z2.
G71 P10 Q20 U0.4 W0.1 D2. F0.3
N10 G0 G42 X-1. Z2.
G1 Z0. F0.1
X16.
X20. Z-2.
Z-20.
G2 X30. Z-25. R5.
G1 Z-40.
X42.
N20 G0 G40 Z2.
G70 P10 Q20
G97 S700 M3
G0 X24. Z4.
G76 X18.16 Z-15. K0.92 D0.3 F1.5 A60
G92 X19. Z-10. F1.5 I-0.5
G0 X60. Z60.
M30
"""
COUNTED = """\
G18G20G40G80G90G99G97S600M3
G0X2.75Z.05
G71U1250R500
G71P100Q101U250W50F.016
N100G00X1.678Z.05
G01Z0.0
G03X1.750Z-.036R.036
G01Z-.200
X2.568
N101G00X2.75
G70P100Q101F.004
G00Z8.0
M30
"""
PROGRAMS = {
    "shaft": (SHAFT, "fanuc", False),
    "bore": (BORE, "fanuc", False),
    "shaft of a Haas": (SHAFT_OF_A_HAAS, "haas", False),
    "lengths in least increments": (COUNTED, "fanuc", True),
}


def differences_of(text: str, dialect: str, counted: bool, run_as: str | None = None) -> list[str]:
    """Differences between the blocks of a program and what the second reader expects."""
    rules = dialects.load(dialect, lathe="A", least_increments=counted)
    policy = ReadingPolicy(tool_lengths="zero")
    blocks = run(run_as or text, dialect=rules, axes=("x", "z"), policy=policy)
    return list(differences(reading_of(text, increments=counted), moves_of(blocks)))


@pytest.mark.parametrize("name", PROGRAMS)
def test_blocks_are_those_of_the_second_reader(name: str) -> None:
    assert differences_of(*PROGRAMS[name]) == []


@pytest.mark.parametrize(("file", "dialect"), [("turning.nc", "fanuc"), ("haas-shaft.nc", "haas")])
def test_shipped_programs_are_those_of_the_second_reader(file: str, dialect: str) -> None:
    text = (SHIPPED / file).read_text(encoding="ascii")
    assert differences_of(text, dialect, False) == []


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("G0 X44. Z0.", "G0 X44. Z0.1"),
        ("Z-55.", "Z-56."),
        ("U0.4 W0.1", "U0.6 W0.1"),
        ("P920 Q300", "P920 Q350"),
        ("X18.6", "X18.5"),
        ("Z-20.\n", ""),
    ],
)
def test_differences_are_reported(old: str, new: str) -> None:
    assert len(re.findall(re.escape(old), SHAFT)) == 1
    assert differences_of(SHAFT, "fanuc", False, SHAFT.replace(old, new))
