"""SINUMERIK on a lathe: diameters, the limit of the speed, turret, threads by K and I."""

from __future__ import annotations

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.tool_table import ToolEntry, ToolTable
from cnc.model.blocks import Polyline, Spindle
from cnc.model.diagnostics import Diagnostic, GcodeError
from tests.support.gcode.gcode_cases import block_summaries, run
from tests.support.paths import ROOT

LATHE = {
    "dialect": dialects.load("siemens"),
    "axes": ("x", "z"),
    "policy": ReadingPolicy(tool_lengths="zero"),
    "lathe": True,
    "tools": ToolTable([ToolEntry(1, 1), ToolEntry(2, 2)]),
}
START = "G18 G90 G95 G97 S600 M4\nG0 X40 Z5\n"
STARTED = ["spindle ccw 600", "rapid 20 5"]


def summaries(source: str) -> list[str]:
    """The blocks of a program, as text, without those at its start and end."""
    found = block_summaries(f"{START}{source}\nM30", **LATHE)
    assert found[:2] == STARTED
    return found[2:-2]


def spindles(source: str) -> list[tuple[float, float]]:
    """Speed and surface speed (mm/s) of the blocks of the spindle."""
    blocks = run(f"{source}\nM30", **LATHE)
    return [(each.rpm, each.surface_speed) for each in blocks if isinstance(each, Spindle)][:-1]


def test_lims_limits_the_speed_and_stays() -> None:
    source = "G96 S120 LIMS=1500 M3\nG97 S300\nG96 S90\nG97 S4000\nLIMS=800\nG96 S60"
    assert spindles(source) == [
        (1500, 2000), (300, 0), (1500, 1500), (1500, 0), (800, 1000)
    ]  # fmt: skip


def test_lims_is_no_limit_without_a_value_above_0() -> None:
    with pytest.raises(GcodeError, match="LIMS-5"):
        spindles("G96 S120 LIMS=-5 M3")


def test_g25_and_g26_limit_the_speed_in_every_mode_and_keep_s() -> None:
    source = (
        "N10 G25 S400\nG26 S2000\nG97 S300 M3\nS2500\nG26 S=1000*2+500\nG26 S1500\nS0\n"
        "G96 S120 LIMS=3000\nLIMS=1000\nG97 S1200"
    )
    assert spindles(source) == [
        (400, 0), (2000, 0), (2500, 0), (1500, 0), (0, 0), (1500, 2000), (1000, 2000), (1000, 0)
    ]  # fmt: skip


def test_the_lowest_speed_of_g96_gives_the_feed_per_revolution() -> None:
    source = "G25 S400\nG26 S1000\nG96 S60 M3 G95\nG0 X100 Z0\nG1 Z-1 F0.5\nG0 X10\nG1 Z-2\nM30"
    blocks = run(source, **LATHE)
    turning = next(block for block in blocks if isinstance(block, Spindle))
    assert (turning.rpm, turning.surface_speed, turning.least_rpm) == (1000, 1000, 400)
    feeds = [60.0 * feed for block in blocks if isinstance(block, Polyline) for feed in block.feeds]
    # 60 m/min at 100 mm are 191 rpm, at 10 mm 1910 rpm.
    assert [feed for feed in feeds if feed == feed] == pytest.approx([200.0, 500.0])


@pytest.mark.parametrize("limit", ["LIMS=800", "G26 S800"])
def test_a_limit_holds_in_a_run_of_plain_lines(limit: str) -> None:
    lines = "\n".join(f"G1 X{number}.5 F100 S{500 + 100 * number}" for number in range(8))
    mill = {"dialect": dialects.load("siemens")}
    found = block_summaries(f"{limit}\nS300 M3\n{lines}\nM30", **mill)
    assert [text for text in found if "cw" in text] == [
        f"spindle cw {speed}" for speed in (300, 500, 600, 700, 800)
    ]


THREADS = {
    "along Z": (
        "G33 Z-20 K1.5",
        ["sync 1.5", "line 20 -20 F900", "sync 0"],
    ),
    "two starts": (
        "G33 Z-20 K4\nG0 Z5\nG33 Z-20 K4 SF=180",
        ["sync 4", "line 20 -20 F2400", "sync 0", "rapid 20 5"]
        + ["sync 4 180", "line 20 -20 F2400", "sync 0"],
    ),
    "along X": ("G33 X60 I2", ["sync 2", "line 30 5 F1200", "sync 0"]),
    "on a cone, further lines without a stop": (
        "G33 Z-5 X44 K2 SF=0\nZ-15 K2\nG0 X50",
        ["sync 2.039608", "line 22 -5 F1223.764683", "line 22 -15 F1200", "sync 0", "rapid 25 -15"],
    ),
    "on a cone of 45 degrees the lead is along either axis": (
        "G33 X50 Z0 I2\nG0 Z5\nG33 X60 Z0 K2",
        ["sync 2.828427", "line 25 0 F1697.056275", "sync 0", "rapid 25 5"]
        + ["sync 2.828427", "line 30 0 F1697.056275", "sync 0"],
    ),
    "plain moves behind the thread end it": (
        "G33 Z-5 K1\nG1 Z-6 F0.1\nZ-7\nZ-8",
        ["sync 1", "line 20 -5 F600", "sync 0"]
        + ["line 20 -6 F60", "line 20 -7 F60", "line 20 -8 F60"],
    ),
    "F stays the feed": (
        "G1 Z4 F0.2\nG33 Z-5 K1\nG1 Z-6",
        ["line 20 4 F120", "sync 1", "line 20 -5 F600", "sync 0", "line 20 -6 F120"],
    ),
}


@pytest.mark.parametrize("name", THREADS)
def test_the_lead_counts_along_the_axis_that_moves_farther(name: str) -> None:
    source, expected = THREADS[name]
    assert summaries(source) == expected


@pytest.mark.parametrize(
    ("source", "code"),
    [
        ("G33 Z-20 I1.5", "pitch-missing"),
        ("G33 Z-20", "pitch-missing"),
        ("G33 Z-20 K0", "value-out-of-range"),
        ("G33 Z-20 K1 SF=360", "value-out-of-range"),
        ("G1 Z-20 F0.2 SF=90", "word-unused"),
        ("G34 Z-20 K1", "pitch-missing"),
        ("G35 Z-20 K1 F0.05", "thread-lead"),
        ("G96 S100\nG33 Z-20 K1", "surface-speed-active"),
        ("M5\nG33 Z-20 K1", "spindle-stopped"),
        ("TRANSMIT", "axis-missing"),
    ],
)
def test_errors(source: str, code: str) -> None:
    with pytest.raises(GcodeError) as caught:
        summaries(source)
    assert caught.value.diagnostic.code == code


def test_the_offset_of_a_tool_is_in_x_and_z() -> None:
    """Siemens, "Tool Offsets": a turning tool has length 1 in X and length 2 in Z (G18)."""
    tools = ToolTable([ToolEntry(1, 1, {"X": -12.0, "Z": -5.0}, 0.8, orientation=2)])
    source = f"{START}T1 D1\nG0 X50 Z1\nD0\nG0 X60 Z1\nM30"
    found = block_summaries(source, **{**LATHE, "tools": tools})
    assert [line for line in found if "rapid" in line][1:] == ["rapid 13 -4", "rapid 30 1"]


def test_a_tool_word_turns_the_turret() -> None:
    assert summaries("T1 D1\nT1 D1\nT2 D1") == ["tool 1", "tool 2"]
    assert summaries("T1\nM6\nT2 M6\nM3") == [
        "tool 1", "spindle off 0", "tool 1", "tool 2", "spindle cw 600"
    ]  # fmt: skip


def test_the_shipped_program_ends_its_lines_where_it_says() -> None:
    text = (ROOT / "programs" / "lathe" / "siemens-shaft.mpf").read_text(encoding="ascii")
    found = block_summaries(text, **LATHE)
    assert [each for each in found if each.startswith("tool")] == ["tool 1", "tool 2", "tool 3"]
    threads = [found[k + 1] for k, each in enumerate(found) if each == "sync 1.5"]
    assert threads == [f"line {x} -18 F900" for x in (9.7, 9.545, 9.39, 9.235, 9.08)]
    assert found[-1] == "end"


OTHER_SPINDLES = ["S3=2400", "M3=3", "S2=500 M2=4", "SETMS(3)"]


@pytest.mark.parametrize("line", OTHER_SPINDLES)
def test_other_spindles_are_not_checked_and_a_run_refuses_them(line: str) -> None:
    with pytest.raises(GcodeError) as caught:
        summaries(line)
    assert caught.value.diagnostic.code == "code-not-supported"
    warnings: list[Diagnostic] = []
    policy = ReadingPolicy(tool_lengths="zero", missing_programs="warn")
    options = LATHE | {"policy": policy, "warn": warnings.append}
    blocks = run(f"{START}{line}\nG1 Z4 F0.1\nM30", **options)
    assert [each.code for each in warnings if each.line == 3] == ["moves-not-checked"] * (
        len(line.split())
    )
    assert [each.rpm for each in blocks if isinstance(each, Spindle)] == [600, 0]


def test_the_first_spindle_needs_no_choice() -> None:
    assert summaries("SETMS(1)\nSETMS\nG1 Z4 F0.1") == ["line 20 4 F60"]
