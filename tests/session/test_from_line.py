"""Runs that begin at a later line: state, safe moves to the line, and the rest of the program."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cnc.api import Callbacks, Report, start_position
from cnc.boards.grbl.driver import GrblBoard
from cnc.gcode.core.program import ProgramOptions, interpret
from cnc.gcode.reader.source_text import Text
from cnc.machine.load import load_machine
from cnc.model.blocks import ArcFeed, Block, Coolant, Dwell, Polyline, Spindle, Tool
from cnc.model.diagnostics import CncError
from cnc.session.resume import RestartPoint
from cnc.simulators.grbl.board import GrblSimulatorBoard
from cnc.simulators.grbl.grbl_simulator import GrblSimulator
from cnc.simulators.grbl.ports import GrblSimulatorPort
from tests.support.boards.simulator_bench import Bench
from tests.support.session.runs import run_with
from tests.support.soak import share

MACHINE = load_machine("grbl-uno")
AXES = MACHINE.axis_names
START = start_position(MACHINE)
HEAD = "G21 G90 G17 G54\nT3 M6\nS9000 M3\nM8\nG0 X0 Y0 Z5\nG1 Z-1 F300\n"


def blocks(text: str, start: np.ndarray | None = None) -> list[Block]:
    return list(read(text, START if start is None else start))


def read(text: str, start: np.ndarray, *, mark_calls: bool = False) -> Iterator[Block]:
    return interpret(
        Text.of_lines(text.split("\n"), "p.nc"),
        axes=AXES,
        dialect="linuxcnc",
        start=start,
        options=ProgramOptions(mark_calls=mark_calls),
    )


def from_line(text: str, line: int, start: np.ndarray = START) -> tuple[list[Block], RestartPoint]:
    restart = RestartPoint(line, "p.nc", AXES, 15.0)
    restart.check(lambda where: read(text, where, mark_calls=True), start)
    return list(restart.passed(read(text, start, mark_calls=True), start)), restart


def moves(program: list[Block]) -> list[tuple[int, tuple[float, ...]]]:
    """Ends of the straight moves and arcs, with their lines."""
    ends: list[tuple[int, tuple[float, ...]]] = []
    for block in program:
        if isinstance(block, Polyline):
            ends += [
                (line, tuple(point))
                for line, point in zip(block.lines.tolist(), block.points.tolist(), strict=True)
            ]
        elif isinstance(block, ArcFeed):
            ends.append((block.line, tuple(block.end.tolist())))
    return ends


WORDS = st.sampled_from(
    [
        "G1 X{a} F{f}",
        "G1 Y{b}",
        "G0 Z5",
        "G1 Z-{c} F200",
        "G91",
        "G90",
        "G2 X{a} Y{b} R60",
        "G55",
        "G54",
        "G20",
        "G21",
        "X{a} Y{b}",
    ]
)


@settings(max_examples=share(60, 12))
@given(
    st.lists(
        st.tuples(WORDS, st.integers(0, 9), st.integers(0, 9), st.integers(1, 9)),
        min_size=2,
        max_size=12,
    ),
    st.data(),
)
def test_the_program_from_the_line_is_unchanged(
    parts: list[tuple[str, int, int, int]], data: st.DataObject
) -> None:
    lines = [form.format(a=a, b=b, c=c, f=100 * c) for form, a, b, c in parts]
    text = HEAD + "\n".join(lines) + "\nG90 G21 G0 X1\nM2\n"
    line = data.draw(st.integers(7, 7 + len(lines)))
    try:
        whole = moves(blocks(text))
    except CncError:
        return
    begun, _ = from_line(text, line)
    rest = [each for each in whole if each[0] >= line]
    before = [point for number, point in whole if number < line]
    made = moves(begun)
    assert made[len(made) - len(rest) :] == rest
    approach = [point for _, point in made[: len(made) - len(rest)]]
    # Across goes at a height to which the program has come, and down only where the rest begins.
    highest = max(START[2], *(point[2] for point in before))
    at = tuple(START)
    for point in approach:
        if point[:2] != at[:2]:
            assert at[2] == point[2] >= highest - 1e-9
        at = point
    assert at == pytest.approx(before[-1])


def test_spindle_coolant_feed_and_offsets_are_restored_before_the_plunge() -> None:
    text = HEAD + "G10 L2 P2 X30\nG55\nX1 F1200\nY7\nX3\nG0 Z5\nM2\n"
    begun, restart = from_line(text, 11)
    kinds = [type(block) for block in begun]
    assert kinds[:5] == [Polyline, Polyline, Spindle, Dwell, Coolant]
    spindle, coolant, down, rest = begun[2], begun[4], begun[5], begun[6]
    assert isinstance(spindle, Spindle)
    assert isinstance(coolant, Coolant)
    assert (spindle.state, spindle.rpm, coolant.flood) == ("cw", 9000.0, True)
    assert isinstance(down, Polyline)
    assert down.points.tolist() == [[31.0, 7.0, -1.0]]
    # as fast as the program went down, not as it goes across
    assert down.feeds.tolist() == [5.0]
    assert isinstance(rest, Polyline)
    assert rest.points[0].tolist() == [33.0, 7.0, -1.0]
    assert rest.feeds[0] == 20.0
    story = "\n".join(restart.steps)
    for reported in (
        "lift Z to 5.000",
        "go to X31.000 Y7.000 Z5.000",
        "tool 3",
        "9000 rpm",
        "flood on",
        "go down to Z-1.000 with F300",
        "line 11",
    ):
        assert reported in story
    assert not any(isinstance(block, Tool) for block in begun)


@pytest.mark.parametrize(
    ("lines", "reported"),
    [
        ("G1 X1 F100\nG1 X5\n", "stay at Y-3.000 Z2.000: no line before gives a place there"),
        ("G0 X1 Z9\nG1 Y5 F100\n", "stay at Y-3.000: no line before gives a place there"),
        # A place that the machine has already is a place all the same.
        ("G0 X1 Y-3 Z9\nG1 Y5 F100\n", ""),
        ("G1 Z1 X0 Y0 F100\nY5\n", ""),
    ],
)
def test_axes_that_no_line_before_names_are_reported(lines: str, reported: str) -> None:
    start = np.array([-3.0, -3.0, 2.0])
    _, restart = from_line(f"G21 G90\n{lines}M2\n", 3, start)
    assert [step for step in restart.steps if "stay" in step] == [reported] * bool(reported)


@pytest.mark.parametrize(
    ("text", "line", "code"),
    [
        ("G1 X1 F100\nG38.2 Z-5 F50\nG1 X2\n", 3, "from-line-unknown"),
        ("M66 P0 L0\nG1 X2 F100\n", 2, "from-line-unknown"),
        ("G92 X0\nG1 X5 F100\nG1 X6\n", 3, "from-line-unknown"),
        ("G91\nG1 X5 F100\nG1 X6\n", 3, "from-line-unknown"),
        ("G2 X10 I5 F100\nG1 X6\n", 2, "from-line-unknown"),
        ("G1 X5 F100\n", 2, "from-line"),
        ("G1 X5 F100\n", 9, "from-line"),
    ],
)
def test_a_line_that_cannot_be_reached_safely_is_refused(text: str, line: int, code: str) -> None:
    with pytest.raises(CncError) as caught:
        from_line(text + "M2\n", line)
    assert caught.value.diagnostic.code == code
    assert caught.value.diagnostic.hint


SUB = """o100 sub
G91 G1 X1 F200
(on the way)
G1 Y1
G90
o100 endsub
G21 G90 G0 X0 Y0 Z5
G1 Z-1 F100
o100 call
G1 X10 F300
o102 repeat [2]
G1 X20
G1 Y8
o102 endrepeat
o100 call
G1 Y10
M2
"""
AFTER = """G21 G90 G0 X0 Y0 Z5
G1 Z-1 F100
M98 P50
G1 X10 F300
M98 P50 L2
G1 Y10
M2
O50
G91 G1 X1 F200
G1 Y1
G90
M99
"""


@pytest.mark.parametrize(
    ("text", "line", "expected"),
    [
        (SUB, 8, [8, 2, 4, 10, 12, 13, 12, 13, 2, 4, 16]),
        (SUB, 9, [2, 4, 10, 12, 13, 12, 13, 2, 4, 16]),
        (SUB, 10, [10, 12, 13, 12, 13, 2, 4, 16]),
        (SUB, 13, [13, 12, 13, 2, 4, 16]),
        (SUB, 15, [2, 4, 16]),
        (SUB, 16, [16]),
        (AFTER, 3, [9, 10, 4, 9, 10, 9, 10, 6]),
        (AFTER, 4, [4, 9, 10, 9, 10, 6]),
        (AFTER, 5, [9, 10, 9, 10, 6]),
        (AFTER, 6, [6]),
    ],
)
def test_a_call_belongs_to_its_line_and_a_loop_begins_at_its_first_pass(
    text: str, line: int, expected: list[int]
) -> None:
    begun, _ = from_line(text, line)
    assert [number for number, _ in moves(begun)][-len(expected) :] == expected
    whole = [point for _, point in moves(blocks(text))]
    assert [point for _, point in moves(begun)][-len(expected) :] == whole[-len(expected) :]
    # Only the moves to the line come before: up, across, down.
    assert len(moves(begun)) - len(expected) <= 3


@pytest.mark.parametrize(("text", "line"), [(SUB, 2), (SUB, 3), (SUB, 4), (AFTER, 9), (AFTER, 10)])
def test_a_run_cannot_begin_in_a_subprogram(text: str, line: int) -> None:
    with pytest.raises(CncError) as caught:
        from_line(text, line)
    assert caught.value.diagnostic.code == "from-line-unknown"
    assert "subprogram" in caught.value.diagnostic.message


def test_without_earlier_motion_there_are_no_moves_to_the_line() -> None:
    begun, restart = from_line("G21 G90\nG1 Z-1 F100\nX5\nM2\n", 2)
    assert [number for number, _ in moves(begun)] == [2, 3]
    assert not any("lift" in reported or "go to" in reported for reported in restart.steps)


def test_line_0_is_refused() -> None:
    with pytest.raises(CncError):
        RestartPoint(0, "p.nc", AXES, None)


@pytest.mark.parametrize("board", ["loopback", "grbl-sim"])
def test_a_run_from_a_line_ends_at_the_end_of_the_program(board: str, tmp_path: Path) -> None:
    program = tmp_path / "p.nc"
    program.write_text(
        "G21 G90\nG0 Z5\nM3 S500\nG1 Z-1 F300\nG1 X10 F900\nY10\nX0\nG0 Z5\nM5\nM2\n"
    )
    asked: list[str] = []
    drawn: list[list[list[float]]] = []

    def draw(places: Sequence[NDArray[np.float64]]) -> None:
        drawn.append([place.tolist() for place in places])

    def ran(answer: bool) -> Report:
        def ask(story: object) -> bool:
            asked.append(str(story))
            return answer

        opened = GrblSimulatorBoard.from_machine(MACHINE) if board == "grbl-sim" else board
        callbacks = Callbacks(on_beginning=ask, on_approach=draw)
        return run_with(program, MACHINE, board=opened, from_line=6, callbacks=callbacks)

    done = ran(True)
    assert done.ok, done.faults
    assert done.end_position == pytest.approx({"x": 0.0, "y": 10.0, "z": 5.0})
    # Up to the highest place before line 6, across, and down.
    assert drawn == [[[0.0, 0.0, 0.0], [0.0, 0.0, 5.0], [10.0, 0.0, 5.0], [10.0, 0.0, -1.0]]]
    refused = ran(False)
    assert refused.stopped_at_line == 0
    assert len(asked) == 2


HOMED = {20: 1, 21: 1, 22: 1, 27: 1.5, 110: 5000.0, 111: 5000.0, 112: 5000.0}
UNLIMITED = MACHINE.model_copy(
    update={
        "axes": {
            letter: axis.model_copy(update={"travel": None})
            for letter, axis in MACHINE.axes.items()
        }
    }
)


def on_homed_machine(tmp_path: Path, text: str, line: int) -> GrblSimulator:
    """Home, go down to a part at machine Z-30, and begin a program at a line."""
    simulator = GrblSimulator(settings=HOMED)
    simulator.core.eeprom.systems["G54"] = (-150.0, -150.0, -30.0)
    for source, begin in (("$H\nG0 X10 Y10\nZ-2\nM2\n", None), (text, line)):
        program = tmp_path / "p.nc"
        program.write_text(source)
        port = GrblSimulatorPort(simulator, hang_up=False)
        board = GrblBoard(port, UNLIMITED, port.clock, "the simulator")
        board.connect()
        before = len(simulator.moves)
        report = run_with(program, UNLIMITED, board=board, from_line=begin, dialect="grbl")
        board.close()
        assert report.ok, report.faults
    assert not [event for event in simulator.events if event.kind == "alarm"]
    del simulator.moves[:before]
    return simulator


def test_a_lift_on_a_homed_machine_goes_no_higher_than_the_program(tmp_path: Path) -> None:
    # Line 7 begins at the greatest height of the program.
    text = "G0 Z5\nX1 Y1\nG1 Z-1 F300\nX20\nG0 Z5\nX0 Y0\nG0 X30 Y30\nG1 Z-1\nG0 Z5\nM2\n"
    simulator = on_homed_machine(tmp_path, text, 7)
    assert simulator.toolpath()[:, 2].max() == pytest.approx(-25.0)
    assert simulator.position == pytest.approx((-120.0, -120.0, -25.0), abs=0.002)


def test_a_lift_keeps_clear_of_the_limit_switch(tmp_path: Path) -> None:
    text = "G0 Z5\nG53 G0 Z0\nX1 Y1\nG1 Z-1 F300\nX20\nG1 X30\nM2\n"
    simulator = on_homed_machine(tmp_path, text, 6)
    assert simulator.toolpath()[:, 2].max() == pytest.approx(-1.5)


def test_a_move_to_a_limit_switch_presses_it() -> None:
    bench = Bench(settings=HOMED | {20: 0})
    bench.send("$H\n", 300.0)
    heard = bench.send("G53G0Z0\n", 5.0)
    assert "ALARM:1" in heard
