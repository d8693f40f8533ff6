"""Whole programs with and without the fast execution of moves: equal blocks and diagnostics."""

from __future__ import annotations

import random
from typing import Any

import pytest

from cnc.gcode.program import line_steps
from cnc.gcode.program.call_stack import Limits
from cnc.gcode.program.program import interpret
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.source_text import Text
from cnc.model.diagnostics import CncError
from tests.gcode.program.test_plain_lines import AXES, bits, line
from tests.support.gcode.fuzzing import Author
from tests.support.gcode.gcode_cases import read
from tests.support.soak import share

LIMITS = Limits(repeated_lines=500)
OTHERS = """\
G2 X1 Y1 R5
G3 X5 Y1 I2 J0
G2 X3 Y3 I1
X2 Y2 R9
G18 G3 X1 Z1 I.5 K0
G17
G19
G3 X0 Y0 R1
G2 I1 J0 F100
R5
G1 X1 R5
G2 X1 Y1 I1 R1
G2 X9 Y9 I.1
G2 A1 I1
G2 G3 X1
G4 P1
M3 S1000
(msg, hello)
(a comment)
/X1 Y1
G91 X1
G90
G20
G21
G93
G94
G92 X1
G55
G54
G10 L2 P2 X.5 R15
G43.1 Z1
G81 X1 Y1 Z-1 R1 F50
G80
G0
G1
#1=5
X#1
G1 X[#1+1] F[100]
G41.1 D1
G40
G90.1
G91.1
G7
G8
G98
G38.2 X9 F10
G5 X9 Y9 I1 J1 P1 Q1
G33 X1 K1
M2
%
O5
N5
N-0
N1.5
G-0 X1
F0
Q5
""".splitlines()
"""Lines that change the meaning of straight moves and arcs, or only look like them."""


def outcome(
    lines: list[str], axes: tuple[str, ...], dialect: str, *, block_delete: bool = False
) -> list[Any]:
    """The blocks, diagnostics and parameters of a program."""
    warnings: list[Any] = []
    executed: list[int] = []
    known = Parameters(macro=dialect == "fanuc")
    found: list[Any] = [warnings]
    try:
        blocks = read(
            Text.of_lines(lines, "t"),
            axes=axes,
            dialect=dialect,
            block_delete=block_delete,
            warn=warnings.append,
            parameters=known,
            limits=LIMITS,
            on_line=executed.append,
        )
        for block in blocks:
            found += bits([block])
    except CncError as error:
        found.append(error.diagnostic)
    return [*found, repr(known.stored()), executed[-1:]]


def agree(
    monkeypatch: pytest.MonkeyPatch,
    lines: list[str],
    axes: tuple[str, ...],
    dialect: str,
    *,
    block_delete: bool = False,
) -> None:
    quick = outcome(lines, axes, dialect, block_delete=block_delete)
    with monkeypatch.context() as patch:
        patch.setattr(line_steps, "SHORTEST", len(lines) + 1)
        patch.setattr(line_steps, "move_of", lambda *_: None)
        slow = outcome(lines, axes, dialect, block_delete=block_delete)
    assert quick == slow, (lines, axes, dialect)


@pytest.mark.timeout(3600)
def test_moves_between_other_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(share(30_000, 250)):
        rng = random.Random(seed)
        axes = rng.choice(AXES)
        lines = [
            rng.choice(
                ["G1 F100", "G21 G90 G17 G1 F500", "G20 G91 G1 F9", "%", "G1 F100", "O1000"]
            ),
            "F100",
        ]
        for _ in range(rng.randint(1, 5)):
            lines += [line(rng, axes) for _ in range(rng.randint(1, 12))]
            lines += [rng.choice(OTHERS) for _ in range(rng.randint(0, 2))]
        if rng.random() < 0.3:
            at = rng.randrange(len(lines))
            lines[at:at] = ["#2=0", "o1 while [#2 LT 3]", "#2=[#2+1]"]
            lines.insert(rng.randint(at + 3, len(lines)), "o1 endwhile")
        agree(
            monkeypatch,
            lines,
            axes,
            rng.choice(["auto", "linuxcnc", "grbl", "fanuc"]),
            block_delete=rng.random() < 0.5,
        )


@pytest.mark.timeout(3600)
def test_random_programs_of_the_whole_language(monkeypatch: pytest.MonkeyPatch) -> None:
    for seed in range(share(30_000, 150)):
        written = Author(seed).program()
        agree(
            monkeypatch,
            list(written.lines),
            written.axes,
            written.dialect,
            block_delete=written.block_delete,
        )


@pytest.mark.parametrize(
    "move", ["X1. Y2", "G1 X1 Y2", "G2 X1. I1. R5", "X1.(X2)", "(X2) X1.0 Y01"]
)
def test_a_distance_without_a_point_is_warned_about_once(
    monkeypatch: pytest.MonkeyPatch, move: str
) -> None:
    for before in (0, 1, 20):
        lines = ["G1 F100", *["X1.5 Y0"] * before, move, *["X3 Y2"] * 20]
        agree(monkeypatch, lines, AXES[0], "fanuc")
        (warning, *_) = outcome(lines, AXES[0], "fanuc")[0]
        assert warning.code == "decimal-point-missing"


def test_lines_of_a_run_count_as_executed_and_as_new() -> None:
    limits = Limits(repeated_lines=100)
    reported: list[int] = []
    lines = ["G1 F100", *["X1", "X2"] * 5000]
    list(read(Text.of_lines(lines, "t"), limits=limits, on_line=reported.append))
    assert reported[-1] == len(lines)
    loop = ["G1 F100", "o1 repeat [1000]", *["X1", "X2"] * 50, "o1 endrepeat"]
    with pytest.raises(CncError) as caught:
        list(read(Text.of_lines(loop, "t"), limits=limits))
    assert caught.value.diagnostic.code == "loop-endless"


def test_an_error_in_a_run_names_its_line() -> None:
    lines = ["G1 F100", *["X1"] * 100, "A1", *["X1"] * 100]
    with pytest.raises(CncError) as caught:
        list(interpret(Text.of_lines(lines, "t")))
    assert (caught.value.diagnostic.line, caught.value.diagnostic.code) == (102, "axis-missing")
