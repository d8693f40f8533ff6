"""The fast path of moves gives the results and errors of the full interpretation, bit for bit."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cnc.gcode import dialects
from cnc.gcode.program.interpreter import Interpreter
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.parser import parse_line
from cnc.model.blocks import ArcFeed, Polyline
from cnc.model.diagnostics import GcodeError

numbers = st.one_of(st.integers(-3, 3), st.floats(-50, 50).map(lambda value: round(value, 3)))


@st.composite
def moves(draw):
    """A line near to the plainest kind, whole or not."""
    words = [
        f"{letter}{draw(numbers)}"
        for letter in draw(st.sets(st.sampled_from("XYZAIJKRF"), max_size=4))
    ]
    code = draw(st.sampled_from(["", "G0", "G1", "G2", "G3"]))
    return " ".join(draw(st.permutations([code, *words])))


@st.composite
def half_turns(draw):
    """An arc that closes: half a turn, there or back."""
    x, y = draw(numbers), draw(numbers)
    return (
        f"G91 {draw(st.sampled_from(['G2', 'G3']))} X{2 * x} Y{2 * y} I{x} J{y}",
        "G1 X0 Y0",
        f"G2 X{2 * x} Y{2 * y} I{x} J{y} F{abs(x)}",
    )


settings = st.sampled_from(
    [
        "G20",
        "G21",
        "G7",
        "G8",
        "G90",
        "G91",
        "G17",
        "G18",
        "G19",
        "G90.1",
        "G91.1",
        "G93",
        "G94",
        "F100",
        "G61.1",
        "(a remark)",
    ]
)
programs = st.lists(
    st.one_of(moves().map(lambda line: (line,)), settings.map(lambda line: (line,)), half_turns()),
    max_size=12,
)


def outcome(lines, *, quick):
    interpreter = Interpreter(
        "p", ("x", "y", "z", "a"), dialects.load("auto"), [1.0, 2.0, 3.0, 4.0], Parameters(), None
    )
    if not quick:
        whole = interpreter._prepare

        def prepare(statement):
            prepared = interpreter._prepared[id(statement)] = replace(whole(statement), quick=None)
            return prepared

        interpreter._prepare = prepare
    faults = []
    for number, line in enumerate(lines, start=1):
        try:
            interpreter.execute(parse_line(line), number)
        except GcodeError as error:
            faults.append((number, error.diagnostic))
    interpreter.out.flush()
    return interpreter.out.ready, faults, interpreter.modal, interpreter.motion.position


def plain(block):
    if isinstance(block, Polyline):
        return block.line, block.points.tobytes(), block.feeds.tobytes(), block.lines.tobytes()
    if isinstance(block, ArcFeed):
        return replace(block, end=None), block.end.tobytes()
    return block


@given(programs)
def test_fast_path_and_full_interpretation_agree(groups):
    lines = [line for group in groups for line in group]
    quick, slow = outcome(lines, quick=True), outcome(lines, quick=False)
    assert [plain(block) for block in quick[0]] == [plain(block) for block in slow[0]]
    assert quick[1:] == slow[1:]


def test_the_fast_path_is_used():
    """Else the comparison would compare the full way with itself."""
    interpreter = Interpreter(
        "p", ("x", "y", "z"), dialects.load("auto"), [0.0] * 3, Parameters(), None
    )
    taken = []
    way = interpreter.motion.quick
    interpreter.motion.quick = lambda move: taken.append(way(move)) or taken[-1]
    for number, line in enumerate(
        ["G1 X1 F100", "Y2", "G0 Z5", "G2 X2 I0.5", "G3 X3 R0.5"], start=1
    ):
        interpreter.execute(parse_line(line), number)
    interpreter.out.flush()
    assert taken == [True] * 5
    first = interpreter.out.ready[0]
    np.testing.assert_array_equal(first.points, [[1, 0, 0], [1, 2, 0], [1, 2, 5]])
