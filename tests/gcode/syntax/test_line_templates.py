"""Statements from templates equal those of the grammar, bit for bit, errors included."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc.gcode.syntax import line_templates, parser
from cnc.gcode.syntax.parameters import Parameters
from cnc.gcode.syntax.parser import Syntax, parse_line
from cnc.gcode.syntax.statement import Statement
from cnc.model.diagnostics import GcodeError
from tests.support.soak import share

NGC = [
    "X[#1+_] Y_ F_", "G1 X[_*#2] (pass _) Y-_", "#5=_ #6=[_/_]", "#<far>=[_ GT _]",
        "g2 x[#1] y_ i-_ j[_**_]", "N_ X[#1+ _ ]  Y [ _ ]",
    "/ X[_ MOD _]", "#[_+1]=_", "#[#7+_]=_", "X#[#1*_]", "X#[_]", "X[ATAN[_]/[_]]", "X[SQRT[_-5]]",
    "X[LN[_]] Y[1/[_-_]]", "X_ Y[#<near>*_] ; tail _",
    "X[ROUND[_]+FIX[-_]]", "G[_] X#1", "M[_]", "X[_ AND _ OR #1]", "X[-_**_]", "X.5 Y[_.]",
        "#1=#2 X[#3]", "x [ # 1 + _ ]", "X-[_] Y+[_]",
    "@_ ^[_*2]", "X[EXISTS[#<far>]+_]", "X[#<near 2>+_]", "G_ X[_]", "X[#_]", "X_._ Y[#1]",
        "X_ _ Y[#1]", "X[_] X[_]", "T[_] S_",
]  # fmt: skip
MACRO = [
    "X[#1+_] Y_.",
    "#100=ROUND[_]",
    "X[ROUND[_/_]]",
    "X#1 Y[#2+_]",
    "#5=[#1 EQ #0] X_",
    "X[FUP[-_]+BIN[_]]",
    "G1X[_*#3]F_",
]
ODD = [
    "o_ call [_]",
    "o1 while [#1 LT _]",
    "(debug, #1 _)",
    "X[_",
    "X[_]] ",
    "X(_)5",
    "BSPLINE SD=_",
    "%",
    "X[_] (a (b) _)",
    "IF [#1 EQ _] GOTO _",
]
WRITTEN = [
    "0",
    "1",
    "2.5",
    ".25",
    "7.",
    "007",
    "123456789.125",
    "3",
    "10",
    "1e",
    "9" * 20,
    "2000000000",
    "0.1",
    "9" * 400,
]


def bits(value: float) -> bytes:
    return struct.pack("d", value) if not math.isnan(value) else b"nan"


def outcome(compute) -> object:  # type: ignore[no-untyped-def]
    try:
        value = compute()
    except GcodeError as error:
        return error.diagnostic
    return bits(value) if isinstance(value, float) else value


def meaning(statement: Statement, parameters: Parameters) -> object:
    """The parts of a statement and its values."""
    words = [
        (word.letter, bits(word.number), word.written, word.column, word.length)
        for word in statement.words
    ]
    computed = [
        (index, outcome(lambda value=value: value(parameters)))
        for index, value in statement.computed
    ]  # type: ignore[misc]
    assignments = [
        (
            each.target
            if isinstance(each.target, str)
            else outcome(lambda each=each: each.target(parameters)),  # type: ignore[misc]
            outcome(lambda each=each: each.value(parameters)),  # type: ignore[misc]
            each.column,
            each.length,
        )
        for each in statement.assignments
    ]
    return (
        words,
        computed,
        assignments,
        statement.remarks,
        statement.control is None,
        statement.percent,
        statement.deletable,
    )


def parameters(*, macro: bool = False) -> Parameters:
    found = Parameters({100: 4.0}, macro=macro)
    for number, value in ((1, 2.5), (2, -3.0), (3, 0.1), (7, 10.0)):
        found.set_number(number, value, 1)
    if not macro:
        found.set_name("near", 1.5, 1)
        found.set_name("near2", 2.5, 1)
    return found


def filled(template: str, written: list[str]) -> str:
    pieces = template.split("_")
    return "".join(piece + number for piece, number in zip(pieces, [*written, ""], strict=False))


@pytest.fixture(autouse=True)
def _no_templates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_templates, "_templates", {})


@settings(max_examples=share(20_000, 30), deadline=None)
@given(st.data())
def test_templates_give_the_statements_of_the_grammar(data: st.DataObject) -> None:
    macro = data.draw(st.booleans())
    syntax = Syntax("macro-b" if macro else "ngc", siemens=True)
    template = data.draw(st.sampled_from((MACRO if macro else NGC) + ODD))
    known = parameters(macro=macro)

    def result_of(text: str, *, in_full: bool) -> object:
        parse_line.cache_clear()
        return outcome(
            lambda: meaning(
                parser._parse(text, syntax, None) if in_full else parse_line(text, syntax), known
            )
        )

    line_templates._templates.clear()
    for _ in range(5):
        text = filled(
            template, [data.draw(st.sampled_from(WRITTEN)) for _ in range(template.count("_"))]
        )
        assert result_of(text, in_full=False) == result_of(text, in_full=True), text


def lines_parsed(monkeypatch: pytest.MonkeyPatch, lines: list[str]) -> int:
    """The number of lines that the grammar parsed."""
    count = 0
    whole = parser._parse

    def counted(*arguments):  # type: ignore[no-untyped-def]
        nonlocal count
        count += 1
        return whole(*arguments)

    monkeypatch.setattr(parser, "_parse", counted)
    parse_line.cache_clear()
    for line in lines:
        meaning(parse_line(line), parameters())
    return count


def test_the_grammar_parses_two_lines_of_a_template(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert lines_parsed(monkeypatch, [f"G1 X[#1+{k}.5] Y{k} (pass {k})" for k in range(50)]) == 3


def test_control_lines_and_comment_commands_are_always_parsed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert lines_parsed(monkeypatch, [f"o{k} while [#1 LT {k}]" for k in range(20)]) == 21, (
        "the second one was tried as a shape"
    )
    assert lines_parsed(monkeypatch, [f"(print, {k}) X[{k}]" for k in range(20)]) == 20


def test_the_number_of_templates_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_templates, "MOST_TEMPLATES", 10)
    for k in range(100):
        parse_line(f"X[#1+{k}] Z[#2{'+#3' * (k % 50)}*{k}]")
        assert len(line_templates._templates) <= 10
