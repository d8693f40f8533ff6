"""SINUMERIK's CYCLE95, CYCLE97 and CYCLE98: moves computed by hand, errors."""

from __future__ import annotations

import math

import pytest

from cnc.gcode import dialects
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.gcode_cases import block_summaries

LATHE = {
    "dialect": dialects.load("siemens"),
    "axes": ("x", "z"),
    "policy": ReadingPolicy(tool_lengths="zero"),
    "lathe": True,
}
START = "G18 G90 G95 G97 S600 M4 DIAMON\nG0 X40 Z5\n"
"""The spindle turns ten times a second; the tool stands at x 20 (radius), z 5."""


def summaries(source: str, contour: str = "") -> list[str]:
    """The blocks of a program behind its start, as text."""
    text = f"{START}{source}\nM30\n"
    if contour:
        text += f"%_N_PART_SPF\n{contour}\nM17\n"
    found = block_summaries(text, **LATHE)
    assert found[:2] == ["spindle ccw 600", "rapid 20 5"]
    return found[2:-2]


SHOULDER = "G1 X20 Z0\nZ-10\nX40"
RELIEF = "G1 X40 Z0\nZ-5\nX30 Z-10\nZ-15\nX40 Z-20\nZ-25"

# The shoulder is 10 mm high: with MID 3, four passes of 2.5 mm. The contour with its allowances of
# 0.2 along Z and 0.5 (radius) ends at x 20.5; the wall is at z -9.8. The cycle starts 1 mm (VRT)
# before and above it.
ROUGHED = [
    "rapid 21.5 5", "rapid 21.5 1.2",
    "rapid 20.5 1.2", "rapid 18 1.2",
    "line 18 -9.8 F150", "line 20.5 -9.8 F150", "rapid 21.5 -8.8", "rapid 21.5 1.2",
    "rapid 19 1.2", "rapid 18 1.2", "rapid 15.5 1.2",
    "line 15.5 -9.8 F150", "line 18 -9.8 F150", "rapid 19 -8.8", "rapid 19 1.2",
    "rapid 16.5 1.2", "rapid 15.5 1.2", "rapid 13 1.2",
    "line 13 -9.8 F150", "line 15.5 -9.8 F150", "rapid 16.5 -8.8", "rapid 16.5 1.2",
    "rapid 14 1.2", "rapid 13 1.2", "rapid 10.5 1.2",
    "line 10.5 0.2 F150", "line 10.5 -9.8 F150", "line 13 -9.8 F150", "rapid 14 -8.8",
    "rapid 21.5 -8.8", "rapid 21.5 1.2",
]  # fmt: skip
FINISHED = [
    "rapid 10 1.2", "line 10 0 F60", "line 10 -10 F60", "line 20 -10 F60",
    "rapid 21.5 -10", "rapid 21.5 1.2",
]  # fmt: skip
BACKWARDS = "G1 X40 Z-10\nX20\nZ0"
CONTOURS: dict[str, tuple[str, str, list[str]]] = {
    "roughing": ('CYCLE95("PART",3,0.2,0.5,0,0.25,0,0.1,1)', SHOULDER, ROUGHED),
    "a contour towards the face": (
        'CYCLE95("PART",3,0.2,0.5,,0.25,,0.1,1)', BACKWARDS, ROUGHED
    ),
    "finishing": ('CYCLE95("part",,0.2,0.5,0,,,0.1,5)', SHOULDER, ROUGHED[:2] + FINISHED),
    "both": ('CYCLE95("PART",3,0.2,0.5,0,0.25,0,0.1,9)', SHOULDER, ROUGHED + FINISHED),
    "inside": (
        'G0 X16\nCYCLE95("PART",5,0,0,0,0.25,0,0.1,3)',
        "G1 X40 Z0\nZ-10\nX20",
        [
            "rapid 8 5", "rapid 8 1", "rapid 9 1",
            "rapid 10 1", "rapid 15 1", "line 15 -10 F150", "line 10 -10 F150", "rapid 9 -9",
            "rapid 9 1", "rapid 14 1", "rapid 15 1", "rapid 20 1", "line 20 0 F150",
            "line 20 -10 F150", "line 15 -10 F150", "rapid 14 -9", "rapid 9 -9", "rapid 9 1",
        ],
    ),
    "along X": (
        'CYCLE95("PART",2,0,0,0,0.25,0,0.1,2)',
        "G1 X40 Z-4\nX10\nZ0",
        [
            "rapid 21 5", "rapid 21 1",
            "rapid 21 0", "rapid 21 -2", "line 5 -2 F150", "line 5 0 F150", "rapid 6 1",
            "rapid 21 1", "rapid 21 -1", "rapid 21 -2", "rapid 21 -4", "line 20 -4 F150",
            "line 5 -4 F150", "line 5 -2 F150", "rapid 6 -1", "rapid 6 1", "rapid 21 1",
        ],
    ),
    "a relief cut, entered with FF2": (
        'CYCLE95("PART",5,0,0,0,0.2,0.1,0.1,1,,,1)',
        RELIEF,
        [
            "rapid 21 5", "rapid 21 1", "rapid 21 -5", "line 20 -5 F60", "line 15 -10 F60",
            "line 15 -15 F120", "line 20 -20 F120", "rapid 21 -19", "rapid 21 1",
        ],
    ),
    "the allowance along Z stays on both walls of a relief cut": (
        'CYCLE95("PART",5,1,0,0,0.2,0.1,0.1,1,,,1)',
        RELIEF,
        [
            "rapid 21 5", "rapid 21 2", "rapid 21 -6", "line 20 -6 F60", "line 15 -11 F60",
            "line 15 -14 F120", "line 20 -19 F120", "rapid 21 -18", "rapid 21 2",
        ],
    ),
    "VRT, DAM and DT": (
        'CYCLE95("PART",10,0,0,0,0.25,0,0.1,1,0.5,4,2)',
        SHOULDER,
        [
            "rapid 22 5", "rapid 22 2", "rapid 20 2", "rapid 10 2",
            "line 10 0 F150", "line 10 -4 F150", "dwell 0.5", "line 10 -8 F150", "dwell 0.5",
            "line 10 -10 F150", "line 20 -10 F150", "rapid 22 -8", "rapid 22 2",
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CONTOURS)
def test_stock_removal(name: str) -> None:
    source, contour, expected = CONTOURS[name]
    assert summaries(source, contour) == expected


def test_radii_give_the_same_moves() -> None:
    source = 'DIAMOF\nCYCLE95("PART",3,0.2,0.5,0,0.25,0,0.1,9)'
    assert summaries(source, "G1 X10 Z0\nZ-10\nX20") == ROUGHED + FINISHED


def test_a_contour_between_labels_is_executed_behind_the_cycle() -> None:
    lines = SHOULDER.splitlines()
    source = 'CYCLE95("BEGIN:LAST",3,0.2,0.5,0,0.25,0,0.1,1)\nF0.1\nBEGIN:\n'
    source += "\n".join(lines[:2]) + f"\nLAST: {lines[2]}\n"
    own = ["line 10 0 F60", "line 10 -10 F60", "line 20 -10 F60"]
    assert summaries(source) == ROUGHED + own


def test_feed_and_motion_are_as_before_the_cycle() -> None:
    source = 'G1 F0.3 Z4\nCYCLE95("PART",10,0,0,0,0.25,0,0.1,1)\nZ3'
    assert summaries(source, SHOULDER)[-1] == "line 21 3 F180"


def test_an_allowance_of_the_radius_of_a_fillet() -> None:
    source = 'CYCLE95("PART",10,0,0,1,0.25,0,0.1,1)'
    found = summaries(source, "G1 X20 Z0\nZ-9\nG2 X22 Z-10 CR=1\nG1 X40")
    assert found[-5:-2] == ["line 11 0 F150", "line 11 -9 F150", "line 20 -9 F150"]


def test_the_allowance_along_the_contour_is_at_right_angles() -> None:
    source = 'CYCLE95("PART",10,0,0,1,0.25,0,0.1,1)'
    found = summaries(source, "G1 X0 Z0\nX20 Z-10\nZ-20\nX40")
    # The cone has 45 degrees: its offset of 1 mm begins at (sqrt 0.5, z sqrt 0.5).
    side = round(math.sqrt(0.5), 6)
    assert f"line {side} {side} F150" in found
    assert "line 11 -19 F150" in found


def thread(*passes: tuple[float, float, float], end: float, clear: float, lead: float) -> list[str]:
    """The moves of passes, each given by its start along Z and its x at start and end."""
    moves = ["overrides false false"]
    for z, x, last in passes:
        along = lead * math.hypot(1.0, (last - x) / (end - z))
        moves += [
            f"rapid {clear:g} {z:.10g}", f"rapid {round(x, 6):.10g} {z:.10g}",
            f"sync {round(along, 6):.10g}",
            f"line {round(last, 6):.10g} {end:g} F{round(along * 600, 6):.10g}",
            "sync 0", f"rapid {clear:g} {end:g}", f"rapid {clear:g} {z:.10g}",
        ]  # fmt: skip
    # A move to where the tool is already is left out.
    return [
        move for k, move in enumerate(moves) if not k or move != moves[k - 1]
    ] + ["overrides true true"]  # fmt: skip


AREA = [0.9 * math.sqrt(k / 3) for k in (1, 2, 3)]
THREADS: dict[str, tuple[str, list[str]]] = {
    "constant area, a finishing pass and one without infeed": (
        "CYCLE97(1.5,,0,-20,20,20,3,2,1,0.1,0,0,3,1,3,1)",
        [
            "rapid 20 3",
            *thread(*[(3, 10 - d, 10 - d) for d in (*AREA, 1, 1)], end=-22, clear=11, lead=1.5),
        ],
    ),
    "constant depth, MPIT, VRT": (
        "CYCLE97(,20,0,-20,20,20,3,2,1,0,0,0,2,0,1,1,3)",
        [
            "rapid 20 3",
            *thread((3, 9.5, 9.5), (3, 9, 9), end=-22, clear=13, lead=2.5),
        ],
    ),
    "inside": (
        "CYCLE97(2,,0,-20,30,30,4,0,1,0,0,0,2,0,2,1)",
        [
            "rapid 14 5", "rapid 14 4", "overrides false false",
            *thread((4, 15.5, 15.5), (4, 16, 16), end=-20, clear=14, lead=2)[2:],
        ],
    ),
    "a cone, extended by run-in and run-out": (
        "CYCLE97(2,,0,-20,20,24,3,2,1,0,0,0,1,0,1,1)",
        ["rapid 20 3", *thread((3, 8.7, 11.2), end=-22, clear=13.2, lead=2)],
    ),
    "two starts: half a lead apart": (
        "CYCLE97(3,,0,-20,20,20,3,2,1,0,0,0,1,0,1,2)",
        ["rapid 20 3", *thread((3, 9, 9), (4.5, 9, 9), end=-22, clear=11, lead=3)],
    ),
    "a start angle of 90 degrees: a quarter of the lead": (
        "CYCLE97(2,,0,-20,20,20,3,2,1,0,0,90,1,0,1,1)",
        ["rapid 20 3.5", *thread((3.5, 9, 9), end=-22, clear=11, lead=2)],
    ),
    "infeed along a flank of 45 degrees": (
        "CYCLE97(2,,0,-20,20,20,3,2,1,0,45,0,2,0,1,1)",
        ["rapid 20 3.5", *thread((3.5, 9.5, 9.5), (3, 9, 9), end=-22, clear=11, lead=2)],
    ),
    "infeed on both flanks in turn": (
        "CYCLE97(2,,0,-20,20,20,3,2,1,0,-45,0,4,0,1,1)",
        [
            "rapid 20 3.75",
            *thread(
                (3.75, 9.75, 9.75), (2.5, 9.5, 9.5), (3.25, 9.25, 9.25), (3, 9, 9),
                end=-22, clear=11, lead=2,
            ),
        ],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", THREADS)
def test_threads(name: str) -> None:
    source, expected = THREADS[name]
    found = summaries(source)
    assert [move for k, move in enumerate(found) if not k or move != found[k - 1]] == expected


def test_a_chain_of_threads_goes_on_without_a_stop() -> None:
    found = summaries("CYCLE98(0,30,-30,30,-60,36,-80,50,10,10,1,,,0,1,0,1.5,2,2,1,1)")
    cone = 2 * math.hypot(30, 3) / 30
    steep = 2 * math.hypot(30, 10.5) / 30
    assert found == [
        "rapid 29.5 5", "rapid 29.5 10", "overrides false false", "rapid 14 10", "sync 1.5",
        "line 14 -30 F900", f"line 17 -60 F{round(cone * 600, 6):.10g}",
        f"line 27.5 -90 F{round(steep * 600, 6):.10g}", "sync 0", "rapid 29.5 -90",
        "rapid 29.5 10", "overrides true true",
    ]  # fmt: skip


ERRORS = {
    "no contour": ('CYCLE95("OTHER",3,,,,,,,1)', "", "sub-unknown"),
    "no name": ("CYCLE95(,3,,,,,,,1)", "", "cycle-word-missing"),
    "no depth": ('CYCLE95("PART",,,,,0.2,,,1)', SHOULDER, "cycle-word-missing"),
    "no kind": ('CYCLE95("PART",3,,,,0.2)', SHOULDER, "value-out-of-range"),
    "kind 13": ('CYCLE95("PART",3,,,,0.2,,,13)', SHOULDER, "code-not-supported"),
    "without rounding": ('CYCLE95("PART",3,,,,0.2,,,201)', SHOULDER, "code-not-supported"),
    "no feed": ('CYCLE95("PART",3,,,,,,,1)', SHOULDER, "feed-missing"),
    "turns back": ('CYCLE95("PART",3,,,,1,,,1)', "G1 X9 Z0\nZ-9\nX30 Z-5", "profile-not-monotone"),
    "one point": ('CYCLE95("PART",3,,,,0.2,,,1)', "G1 X20 Z0", "profile-empty"),
    "a jump": ('CYCLE95("PART",3,,,,0.2,,,1)', f"{SHOULDER}\nGOTOF Q", "profile-line"),
    "an allowance wider than the relief cut": (
        'CYCLE95("PART",5,3,0,0,0.2,,,1)', RELIEF, "allowance-in-pocket"
    ),
    "an allowance larger than the radius of a fillet": (
        'CYCLE95("PART",5,0,0,1.5,0.2,,,1)', "G1 X20 Z0\nZ-9\nG2 X22 Z-10 CR=1\nG1 X40",
        "allowance-in-pocket",
    ),
    "behind the contour": (
        'G0 X10\nCYCLE95("PART",3,,,,0.2,,,1)', SHOULDER, "profile-start"
    ),
    "many passes": ('CYCLE95("PART",0.0001,,,,0.2,,,1)', SHOULDER, "cycle-too-long"),
    "label alone": ('PART: CYCLE95("PART",3,,,,0.2,,,1)', "", "sub-unknown"),
    "no lead": ("CYCLE97(,,0,-20,20,20,3,2,1,0,0,0,1,0,1,1)", "", "pitch-missing"),
    "no height": ("CYCLE97(2,,0,-20,20,20,3,2,,0,0,0,1,0,1,1)", "", "value-out-of-range"),
    "no length": ("CYCLE97(2,,0,0,20,20,3,2,1,0,0,0,1,0,1,1)", "", "thread-length"),
    "no passes": ("CYCLE97(2,,0,-20,20,20,3,2,1,0,0,0,,0,1,1)", "", "value-out-of-range"),
    "a wide angle": ("CYCLE97(2,,0,-20,20,20,3,2,1,0,70,0,1,0,1,1)", "", "value-out-of-range"),
    "constant surface speed": (
        "G96 S100\nCYCLE97(2,,0,-20,20,20,3,2,1,0,0,0,1,0,1,1)", "", "surface-speed-active"
    ),
    "more arguments": (
        "CYCLE97(2,,0,-20,20,20,3,2,1,0,0,0,1,0,1,1,1,7)", "", "code-not-supported"
    ),
    "another plane": (
        "G17\nCYCLE97(2,,0,-20,20,20,3,2,1,0,0,0,1,0,1,1)", "", "turning-plane"
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ERRORS)
def test_errors(name: str) -> None:
    source, contour, code = ERRORS[name]
    with pytest.raises(GcodeError) as caught:
        summaries(source, contour)
    assert caught.value.diagnostic.code == code


def test_a_fault_of_the_contour_is_at_its_line() -> None:
    with pytest.raises(GcodeError) as caught:
        summaries('CYCLE95("PART",3,,,,0.2,,,1)', "G1 X20 Z0\nG2 Z-10 X40")
    assert (caught.value.diagnostic.code, caught.value.diagnostic.line) == ("arc-center-missing", 7)


def test_the_cycles_are_for_a_lathe() -> None:
    options = LATHE | {"lathe": False, "axes": ("x", "y", "z")}
    with pytest.raises(GcodeError) as caught:
        block_summaries("G18 G0 X1 Z1\nCYCLE97(2,,0,-20,20,20,3,2,1,0,0,0,1,0,1,1)\nM30", **options)
    assert caught.value.diagnostic.code == "code-not-supported"
    assert "lathe" in str(caught.value)
