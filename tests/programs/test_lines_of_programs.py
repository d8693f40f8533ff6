"""Programs as lines: what a small reader of GRBL's language makes of them is the motion of the program, within the tolerance."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from board_reader import Move, Reader
from cnc.api import start_position
from cnc.canon import Block
from cnc.errors import GcodeError
from cnc.flatten.translator import PREAMBLE, Translator
from cnc.gcode.program import interpret
from cnc.gcode.text import Text
from cnc.machine.load import load_machine
from cnc.machine.models import Machine
from cnc.path.build import build
from cnc.path.chunk import PathChunk
from cnc.planner.lookahead import LookAhead
from cnc.stream import GcodeLine
from deviation import deviation, path_points
from random_programs import random_program
from support import share

FOLDER = Path(__file__).parents[2] / "programs"
MILL = load_machine(None)
TOLERANCE = MILL.path.tolerance


def blocks_of(program: str, machine: Machine = MILL) -> list[Block]:
    return list(interpret(Text.of_lines(program.splitlines(), "p.nc"), axes=machine.axis_names, start=start_position(machine)))


def translated(blocks: Iterable[Block], machine: Machine = MILL, **options: object) -> tuple[list[GcodeLine], list[PathChunk]]:
    """The lines of a program, and the path that they stand for."""
    translator = Translator(machine, **options)
    chunks: list[PathChunk] = []

    def seen(path):
        for item in path:
            if isinstance(item, PathChunk):
                chunks.append(item)
            yield item

    path = build(blocks, axes=machine.axis_names, start=start_position(machine), tolerance=machine.path.tolerance)
    lines = [line for item in LookAhead(machine).plan(seen(path)) for line in translator.lines(item)]
    return lines + list(translator.end()), chunks


def read(lines: Iterable[GcodeLine]) -> list[Move]:
    reader = Reader()
    return [move for line in lines if (move := reader.read(line.text)) is not None]


def motion(moves: Iterable[Move]) -> np.ndarray:
    return np.concatenate([move.points for move in moves])


def texts(program: str, **options: object) -> list[str]:
    return [line.text for line in translated(blocks_of(program), **options)[0]]


@pytest.mark.parametrize(
    "file", ["bezier", "compensation", "drilling", "fanuc-nurbs", "ngc-nurbs", "siemens-bspline", "thread-mill", "trident"]
)
def test_shipped_programs_are_the_same_motion(file):
    lines, chunks = translated(interpret(Text.of_file(FOLDER / f"{file}.nc"), axes=MILL.axis_names, start=start_position(MILL)))
    path = np.concatenate([path_points(chunk) for chunk in chunks])
    assert deviation(motion(read(lines)), path) <= TOLERANCE


@settings(max_examples=share(300, 12), deadline=None)
@given(seed=st.integers(0, 10**6), offset=st.tuples(*[st.floats(-100, 100).map(lambda x: round(x, 3))] * 3))
def test_random_programs_are_the_same_motion_whatever_the_work_offset(seed, offset):
    lines, chunks = translated(blocks_of(random_program(seed)), work_offset=offset)
    start = dict(zip("XYZ", (-np.array(offset)).tolist(), strict=True))
    reader = Reader(at=start)
    moves = [move for line in lines if (move := reader.read(line.text)) is not None]
    path = np.concatenate([path_points(chunk) for chunk in chunks])
    assert deviation(motion(moves) + offset, path) <= TOLERANCE


def test_true_arcs_stay_one_line_each_in_every_plane():
    program = """G21 G90 G94 G17 F600
G1 X20 Y0 Z0
G2 X20 Y0 I-5 J0 (a full circle)
G3 X10 Y10 Z-2 I-10 J0 (a helix)
G18 G2 X15 Z3 I5 K0
G19 G3 Y12 Z1 J0 K-2
M2
"""
    assert texts(program) == [
        PREAMBLE,
        "G1 X20 F600",
        "G2 X20 Y0 I-5",
        "G3 X10 Y10 Z-2 I-10",
        "G18 G2 X15 Z3 I5",
        "G19 G3 Y12 Z1 K-2",
        "M2",
    ]


def test_every_line_names_its_source_line():
    lines, _ = translated(blocks_of("G21 G90\nG1 X10 F500\nG2 X20 I5\nG1 Y5\nM3 S100\nM5\nM2\n"))
    assert [line.line for line in lines[1:]] == [2, 3, 4, 5, 6, 7]


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ("G4 P2.5", ["G4 P2.5"]),
        ("G4 P7000", ["G4 P3000", "G4 P3000", "G4 P1000"]),
        ("M3 S1000\nM3 S1500\nM4\nM5\nM5", ["M3 S1000", "S1500", "M4 S1500", "M5"]),
        ("M8\nM8\nM9", ["M8", "M9"]),
        ("M3 S1\nT3 M6", ["M3 S1", "M5", "M0 (MSG, put in tool 3, then resume)"]),
        ("M0", ["M0"]),
        ("M1", ["M1"]),
        ("(MSG, Ready? Go! ~ 5%)", ["(MSG, Ready. Go. - 5)"]),
        ("(MSG, größer)", ["(MSG, gr..er)"]),
    ],
)
def test_commands(block, expected):
    assert texts(f"G21\n{block}\nM2\n") == [PREAMBLE, *expected, "M2"]


@pytest.mark.parametrize("block", ["M7", "M62 P1", "M68 E1 Q2", "M66 P1 L0", "M19 R90", "G96 D1000 S100\nM3", "M3 S100\nG33 Z-1 K1"])
def test_what_grbl_has_no_words_for_is_refused_at_its_line(block):
    with pytest.raises(GcodeError) as caught:
        texts(f"G21 G90\n{block}\nM2\n")
    assert caught.value.diagnostic.code == "not-on-board"
    assert caught.value.diagnostic.line >= 2


def test_exact_stops_are_rests():
    assert texts("G21 G90 G61.1\nG1 X10 F600\nG1 X20\nG61 G1 X20 Y10\nM2\n") == [
        PREAMBLE, "G1 X10 F600", "G4 P0", "X20", "G4 P0", "Y10", "M2",
    ]  # fmt: skip


def test_a_probe_says_where_and_how_and_the_way_on_says_all_axes():
    assert texts("G21 G90\nG0 X5 Y5\nG38.2 Z-5 F100\nG0 Z2\nM2\n") == [
        PREAMBLE,
        "G0 X5 Y5",
        "G38.2 Z-5 F100",
        "M0 (MSG, the probe of line 3 was not made: go on in a dry run only)",
        "G0 X5 Y5 Z2",
        "M2",
    ]
