"""Programs for lathes in FANUC's and Haas' language: blocks computed by hand, errors, evidence."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.gcode.dialects.recognition import lathe_dialect, recognise, refuse, refuse_lathe
from cnc.machine.load import load_machine
from cnc.model.blocks import End, Polyline, Spindle, SpindleSync
from cnc.model.diagnostics import Diagnostic, GcodeError
from tests.support.corpus import programs
from tests.support.gcode.gcode_cases import block_summaries, error_of, run
from tests.support.gcode.turning_cases import lathe_blocks, moves_of
from tests.support.paths import ROOT
from tests.support.programs.random_programs import random_program
from tests.support.soak import share

TOOLS = (
    ToolEntry(1, 1, {"X": -20.0, "Z": -5.0}, 0.8, orientation=2),
    ToolEntry(2, 2, {"Z": 1.0}),
)
START = "G21 G97 S600 M3\nG0 X40. Z2.\n"
"""The spindle turns ten times a second; the tool stands at x 20 (radius), z 2."""
STARTED = ["spindle cw 600", "rapid 20 2"]


def summaries(source: str, dialect: str = "fanuc", system: str = "A") -> list[str]:
    """The blocks of a program on a lathe with the axes X and Z, as text."""
    rules = dialects.load(dialect, lathe=system)  # type: ignore[arg-type]
    return block_summaries(
        f"{source}\nM30", dialect=rules, axes=("x", "z"), tools=ToolTable(TOOLS)
    )[: -2 if "M3" in source and not source.endswith("M5") else -1]


# F0.2 at 600 rpm is 120 mm/min.
PROGRAMS: dict[str, tuple[str, list[str]]] = {
    "X is a diameter and F per revolution": ("G1 Z-10. F0.2", ["line 20 -10 F120"]),
    "U and W are increments": ("G1 U-4. W-3. F0.2\nU1.", ["line 18 -1 F120", "line 18.5 -1 F120"]),
    "one coordinate and one increment": ("G1 X30. W-3. F0.2", ["line 15 -1 F120"]),
    "G98 is feed per minute": ("G98 G1 Z-10. F100", ["line 20 -10 F100"]),
    "G99 again": ("G98\nG99 G1 Z-10. F0.1", ["line 20 -10 F60"]),
    "an arc with R and with I and K": (
        "G1 Z0 F0.2\nG3 X50. Z-5. R5.\nG2 U10. W-5. I5. K0",
        ["line 20 0 F120", "arc zx -5 20 25 -5 5 0.25 120", "arc zx -5 30 30 -10 5 -0.25 120"],
    ),
    "G28 by increments": ("G28 U0 W0", ["rapid 20 2", "rapid 0 0"]),
    "G28 of one axis": ("G28 U0", ["rapid 20 2", "rapid 0 2"]),
    "a dwell by U": ("G4 U1.5", ["dwell 1.5"]),
    "a dwell by P": ("G4 P500", ["dwell 0.5"]),
    "G50 sets coordinates": ("G50 X100. Z50.\nG0 X90.", ["rapid 15 2"]),
    "G90": (
        "G90 X36. Z-10. F0.2\nX32.",
        ["rapid 18 2", "line 18 -10 F120", "line 20 -10 F120", "rapid 20 2"]
        + ["rapid 16 2", "line 16 -10 F120", "line 20 -10 F120", "rapid 20 2"],
    ),
    "G90 with a taper by increments": (
        "G90 U-4. W-12. R-1. F0.2",
        ["rapid 17 2", "line 18 -10 F120", "line 20 -10 F120", "rapid 20 2"],
    ),
    "G94": (
        "G94 X10. Z0 F0.2",
        ["rapid 20 0", "line 5 0 F120", "line 5 2 F120", "rapid 20 2"],
    ),
    "G92 is a thread with the lead F": (
        "G92 X38. Z-20. F1.5",
        ["rapid 19 2", "sync 1.5", "line 19 -20 F900", "sync 0", "rapid 20 -20", "rapid 20 2"],
    ),
    "G32 with a start angle of 0": ("G32 Z-20. F2. Q0", ["sync 2", "line 20 -20 F1200", "sync 0"]),
    "G32": ("G32 Z-20. F2.", ["sync 2", "line 20 -20 F1200", "sync 0"]),
    "G32 with a start angle, which counts once": (
        "G32 Z-20. F2. Q180000\nG0 Z2.\nG32 Z-20. F2.",
        ["sync 2 180", "line 20 -20 F1200", "sync 0", "rapid 20 2"]
        + ["sync 2", "line 20 -20 F1200", "sync 0"],
    ),
    "G92 with a start angle, which counts once": (
        "G92 X38. Z-20. F1.5 Q90000\nX37.",
        ["rapid 19 2", "sync 1.5 90", "line 19 -20 F900", "sync 0", "rapid 20 -20", "rapid 20 2"]
        + ["rapid 18.5 2", "sync 1.5", "line 18.5 -20 F900", "sync 0"]
        + ["rapid 20 -20", "rapid 20 2"],
    ),
    "G32 in several lines": (
        "G32 Z-20. F2.\nX48. Z-24.\nG0 X60.",
        ["sync 2", "line 20 -20 F1200", "line 24 -24 F1697.056275", "sync 0", "rapid 30 -24"],
    ),
    "G32 on a cone: the lead is along Z": (
        "G32 X48. Z-18. F2.",
        [f"sync {round(2 * math.hypot(20, 4) / 20, 6)}", "line 24 -18 F1223.764683", "sync 0"],
    ),
    "a one-shot cycle leaves G1 in effect": (
        "G1 Z1. F0.2\nG74 R1.\nG74 Z-5. Q3000\nZ0.",
        ["line 20 1 F120", "line 20 -2 F120", "rapid 20 -1", "line 20 -5 F120", "rapid 20 1"]
        + ["line 20 0 F120"],
    ),
    "G75 grooves side by side": (
        "G75 R0.5\nG75 X30. Z-1. P3000 Q2000 F0.2",
        ["line 17 2 F120", "rapid 17.5 2", "line 15 2 F120", "rapid 20 2"]
        + ["rapid 20 0", "line 17 0 F120", "rapid 17.5 0", "line 15 0 F120", "rapid 20 0"]
        + ["rapid 20 -1", "line 17 -1 F120", "rapid 17.5 -1", "line 15 -1 F120", "rapid 20 -1"]
        + ["rapid 20 2"],
    ),
    "G83 on the axis": (
        "G0 X0\nG83 Z-10. R1. Q4000 F0.2\nG80",
        ["rapid 0 2", "rapid 0 1", "line 0 -3 F120", "rapid 0 1", "rapid 0 -2.5"]
        + ["line 0 -7 F120", "rapid 0 1", "rapid 0 -6.5", "line 0 -10 F120", "rapid 0 2"],
    ),
    "G73 repeats the profile": (
        "G73 U2. W1. R2\nG73 P1 Q2 U1. W0.5 F0.2\nN1 G0 X20.\nN2 G1 Z-5. F0.1",
        ["rapid 22.5 3.5", "rapid 12.5 3.5", "line 12.5 -3.5 F120"]
        + ["rapid 22.5 -3.5", "rapid 22.5 3.5", "rapid 20.5 2.5"]
        + ["rapid 10.5 2.5", "line 10.5 -4.5 F120", "rapid 20.5 -4.5", "rapid 20.5 2.5"]
        + ["rapid 20 2"],
    ),
}


PROGRAMS |= {
    "G28 without axes on a Haas": ("G28", ["rapid 0 0"]),
    "G80 beside G90, which makes no move alone": (
        "G40 G80 G90 G99\nG0 X30.", ["rapid 15 2"]
    ),
    "R, C, I and K behind a straight move": (
        "G1 Z-10. R2. F0.2\nX60. K-1.\nZ-20. I1.\nX70. C1.\nZ-30.",
        ["line 20 -8 F120", "arc zx -8 22 22 -10 2 -0.25 120", "line 29 -10 F120"]
        + ["line 30 -11 F120", "line 30 -19 F120", "line 31 -20 F120", "line 34 -20 F120"]
        + ["line 35 -21 F120", "line 35 -30 F120"],
    ),
    "A is an angle": ("G1 Z-8. A135. F0.2", ["line 30 -8 F120"]),
    "the taper of G90 is I, of G94 K": (
        "G90 X36. Z-10. I-1. F0.2\nG94 X36. Z0. K-1.",
        ["rapid 17 2", "line 18 -10 F120", "line 20 -10 F120", "rapid 20 2"]
        + ["rapid 20 -1", "line 18 0 F120", "line 18 2 F120", "rapid 20 2"],
    ),
    "the taper of G92 is I": (
        "G92 X38. Z-20. I-2. F1.5",
        ["rapid 17 2", f"sync {round(1.5 * math.hypot(22, 2) / 22, 6)}", "line 19 -20 F903.711356"]
        + ["sync 0", "rapid 20 -20", "rapid 20 2"],
    ),
    "G75 with I": (
        "G75 X36. I1. F0.2",
        ["line 19 2 F120", "rapid 19.5 2", "line 18 2 F120", "rapid 20 2"],
    ),
    "G75 of one groove with an increment of 0 along Z": (
        "G75 X36. Z2. P1000 Q0 F0.2",
        ["line 19 2 F120", "rapid 19.5 2", "line 18 2 F120", "rapid 20 2"],
    ),
    "G76 in one line with a start angle": (
        "G76 X38. Z-20. K1. D1. F1.5 Q60000",
        ["overrides false false", "rapid 19 2", "sync 1.5 60", "line 19 -20 F900", "sync 0"]
        + ["rapid 20 -20", "rapid 20 2", "overrides true true"],
    ),
    "G76 in one line": (
        "G76 X38. Z-20. K1. D1. F1.5",
        ["overrides false false", "rapid 19 2", "sync 1.5", "line 19 -20 F900", "sync 0"]
        + ["rapid 20 -20", "rapid 20 2", "overrides true true"],
    ),
}  # fmt: skip
HAAS = {"G28 without axes on a Haas"}


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_of_a_lathe(name: str) -> None:
    source, expected = PROGRAMS[name]
    dialect = "haas" if name in HAAS else "fanuc"
    assert summaries(START + source, dialect) == STARTED + expected


def warnings_of(source: str, **options: object) -> list[str]:
    """The codes of the warnings of a program on a lathe."""
    found: list[Diagnostic] = []
    lathe_blocks(f"{START}{source}\nM30", warn=found.append, **options)  # type: ignore[arg-type]
    return [each.code for each in found]


def test_a_profile_that_ends_with_a_traverse_back_is_roughed_up_to_it() -> None:
    profile = "N1 G0 X20.\nG1 Z-10.\nX40.\n"
    cycle = "G71 P1 Q2 U0.4 W0.1 D4. F0.2\n"
    back = [*map(str, moves_of(lathe_blocks(START + cycle + profile + "N2 G0 Z2.\nM30")))]
    ended = [*map(str, moves_of(lathe_blocks(START + cycle + profile.replace("X40", "N2 X40"))))]
    assert back == ended
    assert "profile-return" in warnings_of(cycle + profile + "N2 G0 Z2.")
    # Below the outside of the stock the traverse would go through the part.
    assert error_on_lathe(cycle + "N1 G0 X20.\nG1 Z-10.\nX30.\nX24.\nN2 G0 Z2.") == "profile-start"


def test_a_profile_beyond_the_start_point_is_reported() -> None:
    source = "G71 P1 Q2 D1. F0.1\nN1 G0 X30.\nG1 Z-5.\nN2 X50."
    assert "profile-beyond-start" in warnings_of(source)


def test_an_arc_without_a_center_is_straight() -> None:
    source = "G3 X50. Z-5. R5. F0.2\nX60."
    assert summaries(START + source)[-1] == "line 30 -5 F120"
    assert "arc-without-center" in warnings_of(source)
    assert error_on_lathe(source, dialect="haas") == "arc-center-missing"


def test_m99_at_the_end_of_a_program_ends_it_after_one_part() -> None:
    assert summaries(f"{START}G1 Z-5. F0.2\nM99")[-1:] == ["line 20 -5 F120"]
    assert "program-ends-once" in warnings_of("M99")


def test_axis_words_before_any_motion_code_are_a_traverse_with_a_warning() -> None:
    assert block_summaries(
        "G28 U0\nW0\nM30", dialect=dialects.load("fanuc", lathe="B"), axes=("x", "z")
    )
    found: list[Diagnostic] = []
    lathe_blocks("X10. Z2.\nM30", warn=found.append)
    assert [each.code for each in found] == ["motion-assumed"]


def test_an_allowance_along_the_passes_of_a_pocket_is_reported() -> None:
    source = "G71 P1 Q2 D1. W0.1 F0.1\nN1 G0 X30. W0\nG1 Z-5.\nX20. Z-9.\nN2 X36. Z-12."
    assert "allowance-at-wall" in warnings_of(source)
    last = moves_of(lathe_blocks(f"{START}{source}\nM30"))
    ends = [tuple(move.points[-1].round(6)) for move in last if not move.rapid]
    assert ends[-3:] == [(15, -4.9), (10, -8.9), (18, -11.9)]


def test_lengths_without_a_point_count_least_increments() -> None:
    rules = dialects.load("fanuc", lathe="A", least_increments=True)
    options = {"dialect": rules, "axes": ("x", "z")}
    source = "G20 G97 S600 M3\nG0 X10000 Z500\nG1 Z-5000 F0.01\nG4 X1500\nG73 U1000 W0 R2\n{}M30"
    found = block_summaries(source.format(""), **options)
    assert found[1:4] == ["rapid 12.7 1.27", "line 12.7 -12.7 F152.4", "dwell 1.5"]
    metric = block_summaries("G21 S600 M3\nG0 X10000 Z500.\nM30", **options)
    assert metric[1] == "rapid 5 500"


def error_on_lathe(source: str, dialect: str = "fanuc") -> str:
    """The code of the error of a program on a lathe."""
    with pytest.raises(GcodeError) as caught:
        lathe_blocks(f"{START}{source}\nM30", dialect)
    return caught.value.diagnostic.code


SYSTEMS = {
    "A": "G99 G1 Z-10. F0.2\nG90 X36. Z-20.\nG0 U2.",
    "B": "G95 G1 Z-10. F0.2\nG77 X36. Z-20.\nG91 G0 X2.",
    "C": "G95 G1 Z-10. F0.2\nG20 X36. Z-20.\nG91 G0 X2.",
}


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_systems_say_the_same_with_other_codes(system: str) -> None:
    start = START if system != "C" else START.replace("G21", "G71")
    expected = ["line 20 -10 F120", "rapid 18 -10", "line 18 -20 F120", "line 20 -20 F120"]
    assert summaries(start + SYSTEMS[system], system=system) == [
        *STARTED, *expected, "rapid 20 -10", "rapid 21 -10"
    ]  # fmt: skip


def test_a_tool_word_turns_the_turret_and_sets_its_offset() -> None:
    source = "G0 X40. Z2.\nT0102\nX40. Z2.\nT0100\nX40. Z2."
    assert summaries(source)[:5] == ["rapid 20 2", "tool 1", "rapid 20 3", "rapid 20 2", "end"][:4]


def test_the_limit_of_the_speed_stays_for_each_g96() -> None:
    blocks = lathe_blocks("G50 S1500\nG96 S120 M3\nG97 S300\nG96 S90\nM5\nM30")
    spindles = [block for block in blocks if isinstance(block, Spindle)]
    assert [(each.rpm, round(each.surface_speed * 60)) for each in spindles[:3]] == [
        (1500, 120_000), (300, 0), (1500, 90_000)
    ]  # fmt: skip


def test_a_facing_cut_to_the_axis_needs_the_limit() -> None:
    source = "G96 S100 M3\nG0 X40. Z0\nG1 X0 F0.1\nM30"
    assert lathe_blocks(f"G50 S1500\n{source}")
    rules = dialects.load("fanuc", lathe="A")
    with pytest.raises(GcodeError) as caught:
        run("G96 S100 M3\nG0 X0 Z0\nG1 Z-1. F0.1", dialect=rules, axes=("x", "z"))
    assert caught.value.diagnostic.code == "spindle-speed-unlimited"


def test_nose_compensation_takes_the_offset_of_the_tool_word() -> None:
    """Orientation 2 of the table: the control point is a radius below and before the centre."""
    source = "T0101\nG0 X40. Z2.\nS600 M3\nG42 G1 X30. F0.2\nZ-10.\nX40.\nG40 G0 X60."
    found = summaries(source)
    # On a cylinder and a face the control point lies on the programmed line.
    entry, cylinder, face = [row.split() for row in found if row.startswith("line")]
    assert entry[1] == "-5"
    assert cylinder[1:3] == ["-5", "-15"]
    assert face[2] == "-15"


def test_g76_takes_less_from_pass_to_pass_and_the_allowance_at_the_end() -> None:
    source = START + "G76 P020060 Q100 R0.05\nG76 X36. Z-20. P1000 Q400 F1.5"
    blocks = summaries(source)
    cuts = [row.split() for row in blocks if row.startswith("line")]
    depths = [19.0 - float(row[1]) for row in cuts]
    # 0.4 times the root of the number, at least 0.1 more each, 0.05 left for two passes.
    expected, depth = [], 0.0
    for number in range(1, 50):
        depth = min(max(0.4 * math.sqrt(number), depth + 0.1), 0.95)
        expected.append(depth)
        if depth == 0.95:
            break
    assert depths == pytest.approx([*expected, 1.0, 1.0], abs=1e-6)
    starts = [
        float(row.split()[2])
        for row in blocks
        if row.startswith("rapid") and row.split()[1] != "20"
    ]
    assert starts == pytest.approx(
        [2.0 - each * math.tan(math.radians(30)) for each in (*expected, 1.0, 1.0)], abs=1e-6
    )
    assert {row.split()[2] for row in map(" ".join, cuts)} == {"-20"}


def test_haas_has_its_cycles_in_one_line() -> None:
    profile = "N1 G0 X30.\nN2 G1 Z-5. F0.1"
    two = START + f"G71 U2. R0.5\nG71 P1 Q2 U0.4 W0.1 F0.2\n{profile}"
    one = START + f"G71 P1 Q2 U0.4 W0.1 D2. F0.2\n{profile}"
    assert summaries(one, "haas") == summaries(two) == summaries(one)


ERRORS = [
    ("tool-word-form", "T1", "write the tool and its offset"),
    ("tool-word-form", "T12345", "two digits"),
    ("tool-unknown", "T0309", "tool 9"),
    ("axis-words-wanted-twice", "G0 X10. U5.", "increment of X"),
    ("compensation-active", "T0101\nG42 G1 X30. F0.2\nT0202", "nose compensation"),
    ("axis-words-unused", "G50 S1500 X10.", "limits the speed"),
    ("code-not-supported", "G33 Z-10. F1.", "another G-code system"),
    ("turning-plane", "G17\nG90 X30. Z-5. F0.1", "give G18"),
    ("cycle-word-missing", "G71 P1 Q2 F0.1\nN1 G0 X30.\nN2 G1 Z-5.", "depth of a pass"),
    ("cycle-word-missing", "G71 R1.", "P and Q"),
    ("cycle-word-missing", "G70", "P and Q"),
    ("cycle-word-missing", "G90 X30. F0.1", "needs Z"),
    ("profile-missing", "G71 U1. R1.\nG71 P7 Q9 F0.1", "no line N7"),
    ("profile-place", "G71 P1 Q2 D1. F0.1\nM8\nN1 G0 X30.\nN2 G1 Z-5.", "between"),
    ("profile-line", "G71 P1 Q2 D1. F0.1\nN1 G0 X30.\nM98 P5\nN2 G1 Z-5.", "no move"),
    ("profile-empty", "G71 P1 Q2 D1. F0.1\nN1 M8\nN2 M9", "no move"),
    ("profile-line", "G71 P1 Q2 D1. F0.1\nN1 G0 X30.\nG70 P1 Q2\nN2 G1 Z-5.", "no move"),
    (
        "decimal-point-needed",
        "G71 U1250 R500\nG71 P1 Q2 F0.1\nN1 G0 X30.\nN2 G1 Z-5.",
        "U1250 is many times deeper",
    ),
    ("profile-start", "G71 P1 Q2 D1. F0.1\nN1 G0 X30.\nN2 G1 X32.", "along Z"),
    ("profile-not-monotone", "G71 P1 Q2 D1. F0.1\nN1 G0 X30.\nG1 Z-9.\nX32.\nN2 Z-5.", "back"),
    ("profile-not-monotone", "G71 P1 Q2 D1. F0.1\nN1 G0 X30.\nG1 Z-5.\nN2 X20. Z-9.", "type II"),
    ("allowance-sign", "G71 P1 Q2 D1. U-0.4 F0.1\nN1 G0 X30.\nN2 G1 Z-5.", "into the part"),
    ("allowance-sign", "G71 P1 Q2 D1. W-0.4 F0.1\nN1 G0 X30.\nN2 G1 Z-5.", "into the part"),
    ("cycle-too-long", "G71 P1 Q2 D0.0001 F0.1\nN1 G0 X30.\nN2 G1 Z-5.", "larger depth"),
    ("word-unused", "G70 P1 Q2 D1.\nN1 G0 X30.\nN2 G1 Z-5. F0.1", "no use"),
    ("thread-start", "G76 P010060 Q100 R0.\nG76 X39. Z-9. P1000 Q300 F1.", "clear"),
    ("thread-length", "G76 P010060 Q100 R0.\nG76 X30. Z2. P1000 Q300 F1.", "no length"),
    ("pitch-missing", "G98 G32 Z-10.", "give F"),
    ("value-out-of-range", "G32 Z-10. F1. Q180.", "Q180000"),
    ("value-out-of-range", "G92 X28. Z-10. F1. Q360001", "start angle"),
    ("pitch-missing", "G34 Z-10. F1.", "give K"),
    ("thread-lead", "G34 Z-10. F2. K-0.2", "falls to 0"),
    ("thread-lead", "G34 Z-3000. F1. K0.001", "1250 turns"),
    ("surface-speed-active", "G96 S100\nG32 Z-10. F1.", "G97"),
    ("cycle-retract-below-bottom", "G83 Z10. R1. Q1000 F0.1", "smaller"),
    ("axis-not-allowed", "G83 Z-10. C5. F0.1", "does not move"),
    ("value-out-of-range", "G75 X36. Z-1. P1000 Q0 F0.2", "more than 0"),
]


@pytest.mark.parametrize(("code", "source", "words"), ERRORS)
def test_errors_of_a_lathe(code: str, source: str, words: str) -> None:
    with pytest.raises(GcodeError) as caught:
        summaries(START + source)
    found = caught.value.diagnostic
    assert found.code == code
    assert words in f"{found.message} {found.hint}"
    assert found.line > 0
    assert found.column > 0


LEADS = [
    ("fanuc", "A", "G34 Z-38. F2. K0.5", 2.0, 0.5, 0.0),
    ("fanuc", "A", "G34 Z-26. F4. K-0.25 Q90000", 4.0, -0.25, 90.0),
    ("fanuc", "B", "G34 X60. Z-38. F2. K0.5", 2.0, 0.5, 0.0),
    ("siemens", "A", "G34 Z-38 K2 F0.5 SF=120", 2.0, 0.5, 120.0),
    ("siemens", "A", "G35 Z-26 K4 F0.25", 4.0, -0.25, 0.0),
]


@pytest.mark.parametrize(("dialect", "system", "line", "lead", "change", "angle"), LEADS)
def test_the_lead_changes_by_k_each_turn(
    dialect: str, system: str, line: str, lead: float, change: float, angle: float
) -> None:
    """After t seconds at 10 turns a second the way along Z is 10 lead t + change (10 t)**2 / 2."""
    start = "G21 G97 S600 M3\nG0 X40. Z2.\n" if dialect == "fanuc" else "G97 S600 M3\nG0 X40 Z2\n"
    siemens = {"lathe": True} if dialect == "siemens" else {}
    rules = dialects.load(dialect, lathe=None if siemens else system)  # type: ignore[arg-type]
    blocks = run(start + line + "\nM30", dialect=rules, axes=("x", "z"), **siemens)
    (begin, _) = (block for block in blocks if isinstance(block, SpindleSync))
    assert begin.angle == angle
    cuts = [block for block in blocks if isinstance(block, Polyline)]
    points = np.concatenate([cut.points for cut in cuts])[1:]
    moves = list(zip(points.tolist(), np.concatenate([cut.feeds for cut in cuts])[1:], strict=True))
    here, time, ways = np.array([20.0, 2.0]), 0.0, []
    for end, feed in moves:
        time += math.dist(here, end) / feed
        here = np.array(end)
        turn = 10.0 * time
        ways.append((2.0 - end[1], lead * turn + change * turn**2 / 2.0))
        # Between two points the lead is constant: the way leaves the thread by less than this.
        assert abs(change) / (8 * 8**2) < 0.001
    assert ways[-1][0] == 2.0 - moves[-1][0][1]
    np.testing.assert_allclose(*zip(*ways, strict=True), atol=1e-9)
    scale = 1.0 if "X" not in line else math.hypot(40.0, 10.0) / 40.0
    assert begin.pitch == pytest.approx(lead * scale)
    turns = (math.sqrt(lead**2 + 2.0 * change * ways[-1][0]) - lead) / change
    assert len(moves) == math.ceil(8 * turns)


def test_a_start_angle_inside_of_a_thread_has_a_warning() -> None:
    assert warnings_of("G32 Z-20. F2.\nX48. Z-24. Q90000") == ["word-idle"]


@pytest.mark.parametrize(
    ("line", "action"), [("X48. Z-24. M8", "coolant false true"), ("X48. Z-24. S500", "spindle")]
)
def test_a_code_between_the_moves_of_a_thread_begins_it_anew(line: str, action: str) -> None:
    """The machine waits for the action: a thread that went on would be out of step."""
    source = f"G32 Z-20. F2.\n{line}\nG0 X60."
    assert warnings_of(source) == ["thread-interrupted"]
    first, _, end, between, again, *_ = summaries(START + source)[2:]
    assert (first, end, again.split()[0]) == ("sync 2", "sync 0", "sync")
    assert between.startswith(action)


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (
            "G83 Z-3. R1. F0.2\nX30. C90.\nH90.\nG80",
            ["rapid 20 2 0", "rapid 20 1 0", "line 20 -3 0 F120", "rapid 20 2 0"]
            + ["rapid 15 2 90", "rapid 15 1 90", "line 15 -3 90 F120", "rapid 15 2 90"]
            + ["rapid 15 2 180", "rapid 15 1 180", "line 15 -3 180 F120", "rapid 15 2 180"],
        ),
        (
            "G87 X36. Z1. C45. R1. F0.2",
            ["rapid 20 2 0", "rapid 20 1 45", "rapid 19 1 45", "line 18 1 45 F120"]
            + ["rapid 20 1 45"],
        ),
    ],
)
def test_holes_lie_round_the_axis_by_c(source: str, expected: list[str]) -> None:
    """FANUC, "Canned cycle for drilling": the hole is at X and C, or at Z and C of a side hole."""
    rules = dialects.load("fanuc", lathe="A")
    found = block_summaries(START + source + "\nM30", dialect=rules, axes=("x", "z", "c"))
    assert [line for line in found if line.split()[0] in ("rapid", "line")] == expected


def test_roughing_leaves_the_rounds_and_chamfers_of_the_profile() -> None:
    profile = "N1 G0 X20.\nG1 Z-10.,R2. F0.1\nX30.,C1.\nN2 Z-20."
    found = summaries(START + f"G71 P1 Q2 U0.4 D20. F0.3\n{profile}\nG70 P1 Q2")
    # The finish is the profile; roughing follows it 0.2 mm away along X.
    assert [row for row in found if row.startswith(("line", "arc"))] == [
        "line 10.2 -8 F180", "arc zx -8 12.2 12.2 -10 2 -0.25 180", "line 14.2 -10 F180",
        "line 15.2 -11 F180", "line 15.2 -20 F180",
        "line 10 -8 F60", "arc zx -8 12 12 -10 2 -0.25 60", "line 14 -10 F60",
        "line 15 -11 F60", "line 15 -20 F60",
    ]  # fmt: skip


def test_haas_needs_a_decimal_point_in_depths() -> None:
    with pytest.raises(GcodeError) as caught:
        summaries(START + "G71 P1 Q2 D2 F0.1\nN1 G0 X30.\nN2 G1 Z-5.", "haas")
    assert caught.value.diagnostic.code == "decimal-point-needed"


def test_a_long_profile_is_refused() -> None:
    lines = "\n".join(f"G1 Z-{number / 1000:.3f}" for number in range(1, 10_003))
    with pytest.raises(GcodeError) as caught:
        summaries(START + f"G71 P1 Q2 D1. F0.1\nN1 G0 X30.\n{lines}\nN2 X35.")
    assert caught.value.diagnostic.code == "profile-too-long"


# Evidence

LATHE_PROGRAMS = [
    "G99\nT0101\nG96 S150 M3\nG1 Z-10. F0.2",
    "T0101\nM3 S800\nG0 X30. Z2.\nG1 Z-20. F0.2",
    "O0001\nG28 U0 W0\nT0202\nG0 X50. Z2.",
    "G50 S1500\nG0 X50. Z2.\nG1 Z-5. F0.1",
    "G0 X50. Z2.\nG71 U2. R1.\nG71 P10 Q20 U0.5 W0.1 F0.3\nN10 G0 X20.\nN20 G1 Z-5.",
    "(HAAS)\nG71 P10 Q20 U0.5 W0.1 D1.5 F0.3\nN10 G0 X20.\nN20 G1 Z-5.",
    "T0505\nG97 S500 M3\nG0 X22. Z3.\nG76 P010060 Q100 R0.1\nG76 X18. Z-20. P1000 Q300 F1.5",
]
MILL_PROGRAMS = [
    "G90 G94 G17\nT1 M6\nG0 X0 Z5.\nG99\nG1 Z-1. F0.5\nX10. F.5",
    "G90 X10. Z5. F100\nG1 X20. F0.5\nG99 G81 Z-5. R1.",
    "T101 M6\nG0 X0 Z5\nG96 S100 D2000\nG1 X5 F0.2",
    "G28 G91 Z0\nG90\nT0101 M6\nG43 H1 Z50.\nG0 X10. Z5.\nG1 Z-1. F.2",
    "G50 S1500\nT0101\nG96 S150\nG0 X0 Y0",
    "G73 X0 Z-5. R1. Q2. F100\nX10.\nG76 X0 Z-5. R1. P500 Q0.2",
    "G20\nG0 X1. Z.5\nG1 Z-.1 F.9\nX2.",
]


@pytest.mark.parametrize("source", LATHE_PROGRAMS)
def test_a_lathe_program_is_refused_on_other_machines(source: str) -> None:
    found = recognise(source.split("\n"))
    for check in (refuse, refuse_lathe):
        with pytest.raises(GcodeError) as caught:
            check(found, "mill", "part.nc")
        diagnostic = caught.value.diagnostic
        assert diagnostic.code == "program-for-lathe"
        assert 'kind = "lathe"' in diagnostic.hint
        assert "in line" in diagnostic.message
        check(found, "lathe", "part.nc")
    assert lathe_dialect(found, "part.nc") in ("fanuc", "haas")


@pytest.mark.parametrize("source", MILL_PROGRAMS)
def test_a_milling_program_is_not_refused(source: str) -> None:
    refuse(recognise(source.split("\n")), "mill", "part.nc")


@pytest.mark.parametrize(
    "file", sorted(Path(ROOT, "programs").rglob("*.nc")), ids=lambda file: file.name
)
def test_shipped_programs_are_for_the_machine_of_their_folder(file: Path) -> None:
    found = recognise(file.read_text(encoding="utf-8").splitlines())
    assert found.turns == (file.parent.name == "lathe")


@pytest.mark.parametrize("seed", range(share(2000, 33)))
def test_generated_milling_programs_are_no_lathe_programs(seed: int) -> None:
    assert not recognise(random_program(seed).splitlines()).turns


@pytest.mark.parametrize(("name", "seed", "text"), tuple(programs(share(50, 2))))
def test_milling_programs_of_cam_systems_are_no_lathe_programs(
    name: str, seed: int, text: str
) -> None:
    assert not recognise(text.splitlines()).turns, (name, seed)
    # Without Y words too: a part that is milled along X only.
    assert not recognise(re.sub(r"Y[-0-9.]+", "", text).splitlines()).turns, (name, seed)


def test_the_shipped_program_turns_within_the_travel_of_the_shipped_lathe() -> None:
    machine = load_machine("lathe")
    file = ROOT / "programs" / "lathe" / "turning.nc"
    found = recognise(file.read_text(encoding="utf-8").splitlines())
    rules = dialects.load(lathe_dialect(found, ""), lenient=True, lathe="A")
    blocks = run(
        file.read_text(encoding="utf-8"),
        dialect=rules,
        axes=machine.axis_names,
        policy=ReadingPolicy(tool_lengths="zero"),
    )
    assert isinstance(blocks[-1], End)
    points = np.vstack([block.points for block in blocks if isinstance(block, Polyline)])
    for column, axis in enumerate(machine.axes.values()):
        assert axis.travel is not None
        assert axis.travel[0] <= points[:, column].min() <= points[:, column].max()
        assert points[:, column].max() <= axis.travel[1]
    # The finished shaft: radii 10, 13, 16 and 23 mm, and the thread's root at 9.08 mm.
    assert {10.0, 13.0, 16.0, 23.0, 9.08} <= set(np.round(points[:, 0], 6))


def test_auto_does_not_guess_what_x_means_on_a_lathe() -> None:
    with pytest.raises(GcodeError) as caught:
        lathe_dialect(recognise(["G0 X10 Z5", "G1 Z-5 F100"]), "part.nc")
    assert caught.value.diagnostic.code == "lathe-dialect-unclear"
    assert lathe_dialect(recognise(["G7 G18", "G0 X10 Z5"]), "part.nc") == "linuxcnc"


def test_a_policy_takes_offsets_of_zero() -> None:
    rules = dialects.load("fanuc", lathe="A")
    warnings: list[str] = []
    run(
        "T0101\nG0 X10. Z5.\nM30",
        dialect=rules,
        axes=("x", "z"),
        policy=ReadingPolicy(tool_lengths="zero"),
        warn=lambda found: warnings.append(found.code),
    )
    assert "tool-length-zero" in warnings


CYCLES_UNDER_COMPENSATION = {
    "G71": "G71 U2. R1.\nG71 P1 Q2 U1. W0.5 F0.2\nN1 G0 X20.\nN2 G1 Z-5. F0.1",
    "G72": "G72 W2. R1.\nG72 P1 Q2 U1. W0.5 F0.2\nN1 G0 Z-5.\nN2 G1 X20. F0.1",
    "G73": "G73 U2. W1. R2.\nG73 P1 Q2 U1. W0.5 F0.2\nN1 G0 X20.\nN2 G1 Z-5. F0.1",
    "G90": "G90 X36. Z-10. F0.2\nX32.",
    "G94": "G94 X10. Z0 F0.2\nZ-1.",
}


@pytest.mark.parametrize("code", ["G41", "G42"])
@pytest.mark.parametrize("name", CYCLES_UNDER_COMPENSATION)
def test_roughing_under_nose_compensation_is_not_compensated(name: str, code: str) -> None:
    """FANUC's cycles rough without it: the passes are those without G41 and G42."""
    cycle, rules = CYCLES_UNDER_COMPENSATION[name], dialects.load("fanuc", lathe="A")
    found: list[str] = []
    source = f"{START}T0101\n{{}} G0 X46.\n{cycle}\n{{}} G0 X60. Z5.\nM30"
    plain, compensated = (
        block_summaries(
            source.format(on, off), dialect=rules, axes=("x", "z"), tools=ToolTable(TOOLS),
            warn=lambda each: found.append(each.code),
        )
        for on, off in (("", ""), (code, "G40"))
    )  # fmt: skip
    assert found.count("cycle-not-compensated") >= 1
    passes = plain[plain.index("rapid 3 2") :]
    assert compensated[compensated.index("rapid 3 2") :] == passes


def test_a_tapered_cycle_under_nose_compensation_is_refused() -> None:
    """Beside a cone the tip of a round nose leaves the programmed line."""
    source = f"{START}T0101\nG42 G0 X42.\nG90 X36. Z-10. R-1. F0.2\nM30"
    rules = dialects.load("fanuc", lathe="A")
    found = error_of(source, dialect=rules, axes=("x", "z"), tools=ToolTable(TOOLS))
    assert found.code == "compensation-active"


def test_a_feed_on_the_axis_without_a_limit_has_the_speed_before() -> None:
    """At X 40 (radius 20) 100 m/min are 795.77 rpm: at 0.1 mm a turn 79.577 mm/min."""
    found: list[str] = []
    blocks = block_summaries(
        "G96 S100 M3\nG0 X40. Z2.\nX0\nG1 Z-1. F0.1\nM30",
        dialect=dialects.load("fanuc", lathe="A"), axes=("x", "z"),
        warn=lambda each: found.append(each.code),
    )  # fmt: skip
    assert blocks[3] == "line 0 -1 F79.577472"
    assert found == ["spindle-speed-assumed"]


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_m5_in_the_line_of_a_cut_stops_behind_it(dialect: str) -> None:
    rules = dialects.load(dialect, lathe="A")
    found = block_summaries(f"{START}G1 Z-10. F0.2 M05\nM30", dialect=rules, axes=("x", "z"))
    assert found == [*STARTED, "line 20 -10 F120", "spindle off 0", "end"]
    mill = "G90 G21 G94\nS600 M3\nG1 X5. F100. M5\nG0 X1.\nM30"
    assert block_summaries(mill, dialect=dialect) == [
        "spindle cw 600", "line 5 0 0 F100", "spindle off 0", "rapid 1 0 0", "end",
    ]  # fmt: skip


@pytest.mark.parametrize("dialect", ["fanuc", "haas"])
def test_g49_alone_has_no_effect(dialect: str) -> None:
    assert summaries(f"{START}G49\nG0 X38.", dialect) == [*STARTED, "rapid 19 2"]


@pytest.mark.parametrize(
    ("line", "dialect"),
    [
        ("G71 P1 Q2 U0.5 W0.1 D1.5 F0.2", "haas"),
        ("G76 X18. Z-20. K1.2 D0.3 F1.5 A60", "haas"),
        ("G71 P1 Q2 U0.5 W0.1 D1500 F0.2", "fanuc"),
    ],
)
def test_a_lathe_program_with_five_digits_is_haas_by_its_cycles(line: str, dialect: str) -> None:
    """Haas' depths have a decimal point; FANUC's D counts thousandths."""
    found = recognise(["%", "O58214", "G50 S2000", "T0101", "G96 S200 M3", line])
    assert lathe_dialect(found, "part.nc") == dialect


def test_an_allowance_of_g76_that_exceeds_the_thread_counts_thousandths() -> None:
    lines = "G0 X40. Z5.\nG76 P010060 Q100 {}\nG76 X37. Z-9. P1000 Q400 F1.5"
    plain, pointed = (summaries(f"{START}{lines.format(r)}") for r in ("R200", "R0.2"))
    assert plain == pointed
    warnings: list[Diagnostic] = []
    run(
        f"{START}{lines.format('R200')}\nM30",
        dialect=dialects.load("fanuc", lathe="A"),
        axes=("x", "z"),
        warn=warnings.append,
    )
    about = [each for each in warnings if each.message.startswith("R200")]
    assert [(each.code, each.line) for each in about] == [("decimal-point-missing", 5)]


def test_the_s_of_g96_may_follow_while_the_spindle_stands() -> None:
    blocks = run(
        "G96\nS120 M3\nG50 S1500\nM30", dialect=dialects.load("fanuc", lathe="A"), axes=("x", "z")
    )
    speeds = [(each.rpm, each.surface_speed) for each in blocks if isinstance(each, Spindle)]
    assert speeds[0] == (0.0, 2000.0)
    assert error_of("G97 S100 M3\nG96\nM30", dialect=dialects.load("fanuc", lathe="A")).code == (
        "spindle-speed-missing"
    )
