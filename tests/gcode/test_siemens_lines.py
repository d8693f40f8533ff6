"""Statements of lines of SINUMERIK, alone and in their window."""

from __future__ import annotations

import random
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.gcode.reader.source_text import Text
from cnc.gcode.reader.statements import Statement
from cnc.gcode.sinumerik.variables import defined_variables
from cnc.model.diagnostics import GcodeError
from tests.support.gcode.gcode_cases import end_of, error_of
from tests.support.soak import share

DEFINED = defined_variables(["DEF REAL DEPTH", "DEF INT COUNT", "DEF REAL GRID[3]=SET(1,2,3)"])
SYNTAX = Syntax("siemens", siemens=True, dialect="siemens", variables=DEFINED)
SHAPES = """
N{i} G1 X={r} Y={r} F={r}
N{i} X{r} Y{r}
  G1 X{s} Z=IC({r}) ; cut {i}
/G0 X={r}
G2 X{r} Y{r} CR={r}
G3 X{r} I=AC({r}) J{r}
R1={r}
R1=R1+{r} R{d}={r}
DEPTH={r}
COUNT={r} X={r}
GRID[1]={r}
GRID[{d}]={r}
X=R1*{r}+SIN({r}) Y=R2/{r}
g1x{r}y{r}f{i}
S1={i} M1=3
M{d}
T{d} D{d}
X={r} M17
RNDM={d} X{r}
G{d} X{r}
A=DC({r}) C={r}
TURN={d} G2 X{r} I{r}
Q={r} W{r}
X=.{i} Y{i}.
X={r}EX3
X{r}{r}
X={r}/0
TRANS X{r}
""".strip("\n").split("\n")


def filled(shape: str, rng: random.Random) -> str:
    while "{" in shape:
        begin = shape.index("{")
        kind = shape[begin + 1]
        number = {
            "i": str(rng.randrange(1, 9000)),
            "r": f"{rng.uniform(0.1, 400):.{rng.randrange(0, 4)}f}",
            "s": f"-{rng.uniform(0.1, 400):.3f}",
            "d": str(rng.randrange(0, 4)),
        }[kind]
        shape = shape[:begin] + number + shape[begin + 3 :]
    return shape


def plain(found: Statement) -> Any:
    """Return a statement with its values computed."""
    parameters = Parameters(macro=False)
    for name in ("_x", "_z", "_absolute", "_incremental", "depth", "count"):
        parameters.bind(name, lambda: 0.5)
    for index in range(5):
        parameters.set_name(f"_r{index}", 1.5 + index, 0)

    def value(compute: Callable[[Parameters], object]) -> object:
        try:
            return compute(parameters)
        except GcodeError as error:
            return error.diagnostic

    return (
        [(w.letter, repr(w.number), w.written, w.column, w.length) for w in found.words],
        [(index, value(each)) for index, each in found.computed],
        [
            (
                each.target if isinstance(each.target, str) else value(each.target),
                value(each.value),
                each.column,
                each.length,
            )
            for each in found.assignments
        ],
        found.remarks,
        found.deletable,
        found.control is None,
    )


def read(line: str) -> Any:
    try:
        return plain(parse_line.__wrapped__(line, SYNTAX))
    except GcodeError as error:
        return error.diagnostic


def test_a_line_of_a_window_has_the_statement_of_the_line_alone() -> None:
    rng = random.Random(20261127)
    lines = [filled(shape, rng) for _ in range(share(40, 8)) for shape in SHAPES]
    text = Text.of_lines(lines, "t")
    text.language = SYNTAX.language
    for number, line in enumerate(lines, 1):
        window = text.window(number)
        assert window is not None
        try:
            found = plain(window.statement(number - window.first, SYNTAX))
        except GcodeError as error:
            found = error.diagnostic
        assert found == read(line), line


@pytest.mark.parametrize("word", ["RNDM={}", "M{}", "T{}", "G{} Y1", "L{}"])
def test_a_word_whose_number_is_its_meaning_is_read_by_itself(word: str) -> None:
    """RNDM=0, M1 and G1 are read beside lines with other numbers, which are refused."""
    lines = [f"X{number} {word.format(number)}" for number in (77, 78, 79, 0, 0)]
    for before, after in pairwise(lines):
        assert read(before) == read(before)
        assert read(after) == read(after)
    if word == "RNDM={}":
        assert isinstance(read(lines[3]), tuple)
        assert not isinstance(read(lines[0]), tuple)


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_values_move_the_tool(count: int) -> None:
    """X is the sum of R1 and the number of the line, and Y the sum of the steps so far."""
    lines = [f"R1={n}.5\nG0 X=R1+{n}.25 Y=IC({n})" for n in range(count)]
    end = end_of("G90 G71\n" + "\n".join(lines), dialect="siemens")
    assert end[:2] == [2 * (count - 1) + 0.75, sum(range(count))]


def test_an_error_in_a_value_names_the_line() -> None:
    divisions = "".join(f"G0 X={n}.5/R0\n" for n in range(3))
    found = error_of(f"R0=1\n{divisions}R0=0\n  G0 X=9.5/R0\nM30", dialect="siemens")
    assert (found.code, found.line, found.column) == ("division-by-zero", 6, 11)


@pytest.mark.parametrize("loops", [False, True])
@pytest.mark.parametrize(
    ("line", "column", "code", "advice"),
    [
        ("G2 X10 Y10 R300.", 12, "code-not-supported", "CR=300."),
        ("G3 X10 Y10 R-10 F100", 12, "code-not-supported", "CR=-10"),
        ("g2 x10 y10 r10 ; arc", 12, "code-not-supported", "CR=10"),
        ("R5", 1, "code-not-supported", "R5=.."),
        ("G1 X1 G21", 7, "code-not-in-dialect", "G71 or G710"),
        ("G20", 1, "code-not-in-dialect", "G70 or G700"),
        ("G43 Z5", 1, "code-not-in-dialect", "D1"),
        ("G49", 1, "code-not-in-dialect", "D0"),
        ("G61.1", 1, "code-not-in-dialect", "G60"),
        ("G54.1 P2", 1, "code-not-in-dialect", "G505"),
    ],
)
def test_words_of_other_controls_are_refused_with_the_word_in_their_place(
    line: str, column: int, code: str, advice: str, loops: bool
) -> None:
    """Siemens, Programming Manual, Fundamentals: list of the G commands, CR=, R parameters."""
    plain = "G1 F100 X1 Y1\nX2\nX3\nX4"
    source = f"R9=0\nWHILE R9<3\n{plain}\n{line}\nR9=R9+1\nENDWHILE\nM30"
    found = error_of(source if loops else f"{plain}\n{line}\nX5\nX6\nM30", dialect="siemens")
    assert (found.code, found.line, found.column) == (code, 7 if loops else 5, column)
    assert advice in found.hint
