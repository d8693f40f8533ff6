"""Runs of straight moves on arrays equal the same lines executed one by one, to the last bit."""

from __future__ import annotations

import gc
import random
from dataclasses import fields
from itertools import chain, islice
from typing import Any

import numpy as np
import pytest

from cnc.gcode import dialects
from cnc.gcode.core.interpreter import Interpreter
from cnc.gcode.core.line_machine import LineMachine
from cnc.gcode.core.line_steps import PlainLines
from cnc.gcode.core.modal_groups import ReadingPolicy
from cnc.gcode.core.program import interpret
from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.parser import Syntax
from cnc.gcode.reader.source_text import Text
from cnc.model.blocks import Answer, ArcFeed, Block, Polyline
from cnc.model.diagnostics import GcodeError
from tests.support.soak import share

AXES = [
    ("x", "y", "z"),
    ("x", "y", "z", "a"),
    ("x", "z"),
    ("x", "y", "z", "a", "b", "c", "u", "v", "w"),
    ("a", "b"),
    ("x", "u"),
]
SETUPS = """\
G20
G21
G90
G91
G93
G94
G95
G2
G3
G80
G10 L2 P1 X1.1 Z-.3
G92 X1
G7
G8
M3 S100
G55
G10 L2 P1 R30
G1 F77
F100
""".splitlines()


class Reader:
    """An interpreter that is given line after line; ``fast``: runs of moves on arrays."""

    def __init__(
        self,
        lines: list[str],
        axes: tuple[str, ...],
        dialect: str,
        *,
        fast: bool,
        laser: bool = False,
    ) -> None:
        self.text = Text.of_lines(lines, "t")
        rules = dialects.load(dialect)
        start = [0.1 * (index + 1) for index in range(len(axes))]
        policy = ReadingPolicy(laser=laser)
        self.interpreter = Interpreter("t", axes, rules, start, Parameters(), None, policy=policy)
        self.interpreter.motion.assumed.end()  # a motion code came before
        self.on_arrays = (
            PlainLines(self.interpreter, LineMachine(self.interpreter)) if fast else None
        )
        self.syntax = Syntax(rules.flavour)
        self.runs = self.executed = 0
        self.error = ""

    def read(self) -> None:
        line = 1
        while window := self.text.window(line):
            index = line - window.first
            count = (
                self.on_arrays.run(window, index) if self.on_arrays and window.simple[index] else 0
            )
            self.runs += count
            if not count:
                try:
                    self.interpreter.execute(window.statement(index, self.syntax), line)
                except GcodeError as error:
                    self.error = f"{line}: {error}"
                    break
            line += count or 1
            self.executed = line - 1
        self.interpreter.out.flush()
        self.blocks = list(chain.from_iterable(self.interpreter.out.ready))

    def left(self) -> Any:
        """The state after the program. ``repr`` distinguishes -0 from 0."""
        interpreter = self.interpreter
        return repr(
            [self.error, interpreter.modal, interpreter.motion.position, interpreter.begun]
        ), bits(self.blocks)


def bits(blocks: list[Block]) -> list[Any]:
    """The blocks as values that are compared bit by bit."""
    return [
        [type(block).__name__, *(_bits(getattr(block, each.name)) for each in fields(block))]
        for block in blocks
    ]


def _bits(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype == np.object_:
        return repr(value.tolist())
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    return "" if isinstance(value, Answer) else repr(value)


def both(
    lines: list[str],
    axes: tuple[str, ...] = AXES[0],
    dialect: str = "auto",
    *,
    laser: bool = False,
) -> Reader:
    """Run the program both ways and compare; return the fast reader."""
    readers = [Reader(lines, axes, dialect, fast=fast, laser=laser) for fast in (False, True)]
    for reader in readers:
        reader.read()
    assert readers[0].left() == readers[1].left(), lines
    return readers[1]


def number(rng: random.Random) -> str:
    return rng.choice(
        [
            f"{rng.uniform(-99, 99):.{rng.randint(0, 6)}f}",
            str(rng.randint(-9, 9)),
            "0",
            "-0",
            ".1",
            f"{rng.random()!r}"[:16],
        ]
    )


def line(rng: random.Random, axes: tuple[str, ...]) -> str:
    words = [letter.upper() + number(rng) for letter in axes if rng.random() < 0.5]
    if rng.random() < 0.3:
        words.append(rng.choice(["G0", "G1", "G01", "G1.", "G00"] + ["G1"] * 20 + ["G-0"]))
    if rng.random() < 0.15:
        words.append(
            "F"
            + rng.choice(
                [
                    f"{rng.uniform(0.1, 5000):.2f}",
                    "100",
                    "0",
                    "-1",
                    "0.00001",
                    "0.00006",
                    "0.0000001",
                    *["60"] * 50,
                ]
            )
        )
    if rng.random() < 0.003:
        words.append(rng.choice("ABCUVWXYZ") + number(rng))
    rng.shuffle(words)
    if rng.random() < 0.1:
        words.insert(0, f"N{rng.randint(0, 99)}")
    if rng.random() < 0.05:
        words.append(rng.choice(["(note)", "; note"]))
    return rng.choice(["", " "]).join(words)


@pytest.mark.timeout(3600)
def test_runs_on_arrays_equal_lines_one_by_one() -> None:
    fast = total = errors = 0
    for seed in range(share(40_000, 80)):
        rng = random.Random(seed)
        axes = rng.choice(AXES)
        lines = [rng.choice(["G1 F100", "G0", "F60.5", "G91 G1 F1", ""])]
        for _ in range(rng.randint(1, 6)):
            lines += [line(rng, axes) for _ in range(rng.randint(1, 12))]
            if rng.random() < 0.4:
                lines.append(rng.choice(SETUPS))
        found = both(lines, axes, rng.choice(["auto", "linuxcnc", "grbl", "fanuc"]))
        fast += found.runs
        total += found.executed
        errors += bool(found.error)
    assert fast > 0.5 * total, "most lines must be executed on arrays"
    assert 0.1 < errors / share(40_000, 80) < 0.95


def test_polylines_are_cut_at_the_same_moves() -> None:
    for before in (0, 1, 4095, 5000):
        lines = (
            ["G1 F100"]
            + ["X1 G1"] * before
            + ["G4 P1"] * (before > 4000)
            + [f"X{n % 50}" for n in range(9000)]
            + ["M3 S1"]
            + ["X5"] * 10
        )
        found = both(lines)
        assert found.runs == len(lines)


RASTER = ["X{x}S{s}"] * 8 + ["G1X{x}F600S{s}", "S{s}", "G0Y{x}S0", "X{x}", "G3X{x}I1", "M4S{s}"]
"""Lines of laser posts: power on each line, power alone, traverses without power, arcs."""
STANDING = ["M5", "M3 S9", "M9", "M8", "G4 P0.1", "G2 X1 I1 S7", "F500"]


def raster(rng: random.Random, count: int) -> list[str]:
    """Lines of rasters, with other blocks between some of them."""
    found = ["G91 G1 F600", rng.choice(["M3 S0", "M4 S5", "X1"])]
    other = rng.choice([0.0, 0.002, 0.1])
    for _ in range(count):
        chosen = STANDING if rng.random() < other else RASTER
        found.append(rng.choice(chosen).format(x=rng.randint(-9, 9) / 8, s=rng.randint(0, 3)))
    return found


@pytest.mark.parametrize("laser", [False, True])
def test_lines_with_power_on_arrays_equal_lines_one_by_one(laser: bool) -> None:
    carried = 0
    for seed in range(share(4000, 20)):
        rng = random.Random(seed)
        lines = raster(rng, rng.choice([20, 300, 3000, 9000]))
        found = both(lines, laser=laser).blocks
        carried += any(isinstance(each, Polyline) and each.commands is not None for each in found)
    assert carried > 0.5 * share(4000, 20)


@pytest.mark.parametrize("laser", [False, True])
@pytest.mark.parametrize("moves", share([4095, 4096, 4097, 8192], [4096]))
@pytest.mark.parametrize("tail", [[], ["S7"], ["S7", "X1"], ["S7", "S8", "X1"], ["S7", "G4 P1"]])
def test_power_where_a_polyline_is_full(laser: bool, moves: int, tail: list[str]) -> None:
    lines = ["G91 G1 F600", "M4 S1", *["X1"] * moves, *tail]
    assert both(lines, laser=laser).runs == len(lines)


@pytest.mark.parametrize("between", [4094, 4095, 4096, 4097, 7000])
def test_polylines_between_other_blocks_are_cut_at_the_same_moves(between: int) -> None:
    """Arcs before and after a run of moves that is about as long as the longest polyline."""
    moves = [f"X{n % 50}" for n in range(between)]
    found = both(["G1 F100 X0 Y0", "G2 X1 R9", "G1", *moves, "G3 X60 R90", "G1", *moves, "G2 I1"])
    assert found.runs > 2 * between


@pytest.mark.parametrize("mode", ["G95", "G10 L2 P1 R10", "G86 X1 Z1 R2 P1"])
def test_unsupported_modes_are_left_to_the_interpreter(mode: str) -> None:
    found = both(["F100 S100 M3", "G1 Z9", mode, *["X1 F5"] * 20])
    assert found.runs == 2


def test_moves_under_inverse_time_take_a_minute_over_f() -> None:
    """Lengths of x y z, else of u v w, else of a b c; a traverse needs no F."""
    lines = ["G93", "G1 X3 Y4 F2", "U4 F30", "A90 F6", "X3 A180 F6"]
    lines += ["X0 A0 F60", "G0 X9", "G1 X9 F7"]
    found = both(["G0 X0 Y0 A0 U1", *lines], ("x", "y", "a", "u"))
    (_, block) = found.blocks
    assert isinstance(block, Polyline)
    rates = [5 * 2 / 60, 3 * 30 / 60, 90 * 6 / 60, 90 * 6 / 60, 3 * 60 / 60, np.nan, 7 / 60]
    np.testing.assert_allclose(block.feeds, rates, rtol=1e-15)
    assert block.timed
    assert found.runs == len(lines)


@pytest.mark.parametrize(
    ("lines", "error"),
    [
        (["G1 X1"], "feed-missing"),
        (["F1"], ""),
        (["G0 X1 F1"], ""),
        (["G1 F1"], ""),
        (["G1 X1 F-1"], "feed-not-positive"),
        (["G1 X1 F0.00001"], "feed-too-slow"),
        (["G81 X1 Z-1 R1 F1"], "inverse-time-active"),
        (["G2 X1 R9 F1"], ""),
    ],
)
def test_other_lines_under_inverse_time_are_left_to_the_interpreter(
    lines: list[str], error: str
) -> None:
    found = both(["G0 X0 Y0 Z9", "G93", *lines])
    assert found.runs == 1
    assert error in found.error if error else not found.error


@pytest.mark.parametrize(
    ("lines", "error"),
    [
        (["G1 X1"], "1: feed-missing"),
        (["X1"], "1: motion-missing"),
        (["G1 F100", "X1", "A1"], "3: axis-missing"),
        (["G1 F100", "X1", "X1 F0.00001"], "3: feed-too-slow"),
        (["G0 X1", "X2", "G1", "X3"], "4: feed-missing"),
    ],
)
def test_errors_in_runs_equal_those_of_single_lines(lines: list[str], error: str) -> None:
    found = both(lines)
    assert found.error.startswith(error)
    assert found.runs == len(lines) - 1


def test_moves_of_rotary_axes_alone_use_the_rotary_feed() -> None:
    found = both(["G20 G1 F60", "A1", "X1", "X1 A1", "X1 A2", "X2 A2", "A2", "A0 X2"], ("x", "a"))
    (block,) = found.blocks
    assert isinstance(block, Polyline)
    inch = 25.4
    assert block.feeds.tolist() == [1.0, inch, inch, 1.0, inch, inch, 1.0]
    assert found.runs == 7


def test_traverses_have_no_feed() -> None:
    found = both(["G0 X1 F60", "G1 X2", "G0", "X3", "Y-0"])
    (block,) = found.blocks
    assert isinstance(block, Polyline)
    assert np.array_equal(block.feeds, [np.nan, 1.0, np.nan, np.nan], equal_nan=True)
    assert block.lines.tolist() == [1, 2, 4, 5]


@pytest.mark.parametrize("between", [[], ["G1 X5"]])
def test_blocks_of_a_long_program_do_not_exist_at_once(between: list[str]) -> None:
    """Their memory would not fit into the cache, which doubles the time that they take."""
    lines = ["G17 G91 G1 F500 X0", *["G2 X1 I0.5", *between] * 6000, "M2"]
    gc.collect()
    blocks = interpret(Text.of_lines(lines, "arcs.nc"))
    taken = list(islice((block for block in blocks if block.line > 5000), 1))
    kept = sum(isinstance(each, ArcFeed | Polyline) for each in gc.get_objects())
    assert len(taken) == 1
    assert kept < 20
