"""SINUMERIK's drilling cycles and patterns of holes."""

from __future__ import annotations

import pytest

from cnc.gcode.core.call_stack import Limits
from tests.support.gcode.gcode_cases import block_summaries, error_of


def summaries(source: str) -> list[str]:
    return block_summaries(f"{source}\nM30", dialect="siemens")[:-1]


CYCLES = {
    # 4, then 4 - 1.5, then not below 1.5; the last 2 in two equal strokes, 0.6 above the last depth
    "CYCLE83(20,0,2,-10,,-4,,1.5,,,1,1)": [
        "rapid 0 0 2", "line 0 0 -4 F100", "rapid 0 0 2", "rapid 0 0 -3.4", "line 0 0 -6.5 F100",
        "rapid 0 0 2", "rapid 0 0 -5.9", "line 0 0 -8 F100", "rapid 0 0 2", "rapid 0 0 -7.4",
        "line 0 0 -9 F100", "rapid 0 0 2", "rapid 0 0 -8.4", "line 0 0 -10 F100", "rapid 0 0 20",
    ],
    # chips are broken: 1 mm back, no lift out of the hole
    "CYCLE83(20,0,2,,10,,4,0,0.5,,1,0)": [
        "rapid 0 0 2", "line 0 0 -4 F100", "dwell 0.5", "line 0 0 -3 F100", "line 0 0 -8 F100",
        "dwell 0.5", "line 0 0 -7 F100", "line 0 0 -10 F100", "dwell 0.5", "rapid 0 0 20",
    ],
    # M6 has a pitch of 1 mm: 400/min in, 800/min out; then the spindle as before
    "CYCLE84(20,0,2,-10,,0.5,3,6,,0,400,800)": [
        "rapid 0 0 2", "spindle cw 400", "line 0 0 -10 F400", "dwell 0.5", "spindle ccw 800",
        "line 0 0 2 F800", "spindle cw 800", "rapid 0 0 20", "spindle cw 500",
    ],
    "CYCLE84(20,0,2,-10,,,5,,-1.5,0,200)": [
        "rapid 0 0 2", "spindle ccw 200", "line 0 0 -10 F300", "spindle cw 200", "line 0 0 2 F300",
        "spindle off 0", "rapid 0 0 20",
    ],
    # strokes of DAM with the chip broken (VARI 1: back by VRT), or brought out (VARI 2)
    "CYCLE84(20,0,2,-7,,,5,,1,0,100,100,0,1,,1,3,0.5)": [
        "rapid 0 0 2", "spindle cw 100", "line 0 0 -3 F100", "spindle ccw 100",
        "line 0 0 -2.5 F100", "spindle cw 100", "line 0 0 -6 F100", "spindle ccw 100",
        "line 0 0 -5.5 F100", "spindle cw 100", "line 0 0 -7 F100", "spindle ccw 100",
        "line 0 0 2 F100", "spindle off 0", "rapid 0 0 20",
    ],
    "CYCLE84(20,0,2,-5,,,5,,1,0,100,100,0,1,,2,3)": [
        "rapid 0 0 2", "spindle cw 100", "line 0 0 -3 F100", "spindle ccw 100",
        "line 0 0 2 F100", "spindle cw 100", "line 0 0 -5 F100", "spindle ccw 100",
        "line 0 0 2 F100", "spindle off 0", "rapid 0 0 20",
    ],
    # spindle and program stop at the bottom, then out
    "CYCLE87(20,0,2,-10,,3)": [
        "rapid 0 0 2", "line 0 0 -10 F100", "spindle off 0", "stop", "rapid 0 0 20",
    ],
    "CYCLE88(20,0,2,-10,,1,3)": [
        "rapid 0 0 2", "line 0 0 -10 F100", "dwell 1", "spindle off 0", "stop", "rapid 0 0 20",
    ],
    "CYCLE85(20,0,2,,10,1,80,160)": [
        "rapid 0 0 2", "line 0 0 -10 F80", "dwell 1", "line 0 0 2 F160", "rapid 0 0 20",
    ],
    # off the wall by RPA, RPO and RPAP, up, back to the middle
    "CYCLE86(20,0,2,-10,,0.5,3,-1,0,1,45)": [
        "rapid 0 0 2", "line 0 0 -10 F100", "dwell 0.5", "orient 45", "rapid -1 0 -9",
        "rapid -1 0 2", "rapid 0 0 2", "spindle cw 500", "rapid 0 0 20",
    ],
    # the arguments that Fusion 360 adds: strokes shrink to MDEP; a left-hand thread by AMODE
    "CYCLE83(20,0,2,-10,,-4,,1.5,,,1,1,,2,0,0,0,0,0,1001110)": [
        "rapid 0 0 2", "line 0 0 -4 F100", "rapid 0 0 2", "rapid 0 0 -3.4", "line 0 0 -6.5 F100",
        "rapid 0 0 2", "rapid 0 0 -5.9", "line 0 0 -8.25 F100", "rapid 0 0 2", "rapid 0 0 -7.65",
        "line 0 0 -10 F100", "rapid 0 0 20",
    ],
    "CYCLE84(20,0,2,-10,,,5,,1.5,0,200,200,0,1,,0,,,,,,0,0,1002002)": [
        "rapid 0 0 2", "spindle ccw 200", "line 0 0 -10 F300", "spindle cw 200", "line 0 0 2 F300",
        "spindle off 0", "rapid 0 0 20",
    ],
    "CYCLE84(20,0,2,-10,,,5,,1.5,0,200,200,0,1,,0,,,,,,0,0,1001002)": [
        "rapid 0 0 2", "spindle cw 200", "line 0 0 -10 F300", "spindle ccw 200", "line 0 0 2 F300",
        "spindle off 0", "rapid 0 0 20",
    ],
    # in and out at the same feed
    "CYCLE89(20,0,2,-10,,1)": [
        "rapid 0 0 2", "line 0 0 -10 F100", "dwell 1", "line 0 0 2 F100", "rapid 0 0 20",
    ],
    "CYCLE81(20,0,2,-10,,0,0,10)": ["rapid 0 0 2", "line 0 0 -10 F100", "rapid 0 0 20"],
    "CYCLE82(20,0,2,-10,,1,0,1,12)": [
        "rapid 0 0 2", "line 0 0 -10 F100", "dwell 1", "rapid 0 0 20",
    ],
}  # fmt: skip


@pytest.mark.parametrize("cycle", CYCLES)
@pytest.mark.parametrize("modal", [False, True])
def test_a_cycle_makes_its_moves(cycle: str, modal: bool) -> None:
    head = "G90 G0 Z50 S500 M3 F100"
    text = f"{head}\nMCALL {cycle}\nX0\nMCALL" if modal else f"{head}\n{cycle}"
    found = summaries(text)
    begin = 2 + modal
    assert found[begin : begin + len(CYCLES[cycle])] == CYCLES[cycle]


@pytest.mark.parametrize("cycle", CYCLES)
@pytest.mark.parametrize(
    ("head", "order", "mode"), [("G18 G0 Y50", (1, 2, 0), "2"), ("G19 G0 X50", (2, 0, 1), "3")]
)
def test_a_cycle_drills_along_the_axis_of_its_plane(
    cycle: str, head: str, order: tuple[int, int, int], mode: str
) -> None:
    """The first axis of G18 is Z and of G19 Y; the tool axis is Y and X."""
    wanted = []
    for step in CYCLES[cycle]:
        kind, *rest = step.split()
        if kind in ("rapid", "line"):
            rest[:3] = [rest[axis] for axis in order]
        wanted.append(" ".join((kind, *rest)))
    text = cycle.replace(",0,1,12)", f",0,{mode},12)")
    assert summaries(f"S500 M3 F100\n{head}\n{text}")[2 : 2 + len(wanted)] == wanted


@pytest.mark.parametrize(("plane", "first"), [("G18", "rapid 0 0 5"), ("G19", "rapid 0 5 0")])
def test_holes_lie_in_the_plane(plane: str, first: str) -> None:
    found = summaries(f"{plane} F100\nMCALL CYCLE81(9,0,1,-2)\nHOLES1(0,0,0,5,10,2)\nMCALL")
    assert next(each for each in found if each.startswith("rapid")) == first


def test_repetitions_without_an_end_in_sight_are_refused() -> None:
    """Each of these is allowed, but not both within each other."""
    source = "AA:\nBB: R1=1\nR1=2\nREPEAT BB P=999\nREPEAT AA P=999\nM30"
    limits = Limits(repeated_lines=1000)
    found = error_of(source, dialect="siemens", limits=limits)
    assert (found.code, found.line, "REPEAT" in found.message) == ("loop-endless", 4, True)


def test_a_cycle_refuses_another_plane_or_axis() -> None:
    for call in ("CYCLE81(20,0,2,-10,,0,0,1)", "CYCLE83(20,0,2,-10,,-4,,1,,,1,1,3)"):
        found = error_of(f"G18 F100\n{call}\nM30", dialect="siemens")
        assert found.code == "code-not-supported"


def test_the_feed_of_a_cycle_ends_with_it() -> None:
    found = summaries("G0 Z50 F100\nCYCLE85(20,0,2,,10,1,80,160)\nG1 X1")
    assert found[-1] == "line 1 0 20 F100"
