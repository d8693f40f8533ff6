"""Statements: computed words, assignments, commands in comments, control."""

from __future__ import annotations

import math
from typing import Any

import pytest

from cnc.gcode.reader.parameters import Parameters
from cnc.gcode.reader.parser import Syntax, parse_line
from cnc.gcode.reader.statements import Control, Statement
from cnc.gcode.reader.words import Word
from cnc.model.diagnostics import GcodeError

NGC = Syntax("ngc", siemens=True)
MACRO = Syntax("macro-b", dialect="fanuc")
GRBL = Syntax("none", dollar=True, dialect="grbl")


def known() -> Parameters:
    parameters = Parameters()
    for number in range(1, 31):
        parameters.set_number(number, float(number), 1)
    parameters.set_name("a", 12.0, 1)
    return parameters


def control(text: str, syntax: Syntax = NGC) -> Control:
    found = parse_line(text, syntax).control
    assert found is not None
    return found


def plain(found: Control) -> tuple[Any, ...]:
    """Keyword, label and computed values."""
    parameters = known()
    label = found.label if isinstance(found.label, str) else found.label(parameters)
    return (found.keyword, label, *(value(parameters) for value in found.values))


def test_a_computed_word_has_nan_and_its_column() -> None:
    statement = parse_line("n10 G1 x [ #1 + 2 ] y-#2 Z3.5 a sin[#30] f#<A>")
    assert [word.letter for word in statement.words] == list("NGXYZAF")
    numbers = [word.number for word in statement.words]
    assert [math.isnan(number) for number in numbers] == [
        False,
        False,
        True,
        True,
        False,
        True,
        True,
    ]
    assert statement.words[2] == Word("X", numbers[2], "X[#1+2]", 8, 12)
    assert [(word.written, word.column, word.length) for word in statement.words[3:]] == [
        ("Y-#2", 21, 4), ("Z3.5", 26, 4), ("ASIN[#30]", 31, 10), ("F#<A>", 42, 5)
    ]  # fmt: skip
    parameters = known()
    assert [(index, value(parameters)) for index, value in statement.computed] == [
        (2, 3.0), (3, -2.0), (5, pytest.approx(0.5)), (6, 12.0)
    ]  # fmt: skip


def test_a_constant_in_brackets_is_a_computed_word() -> None:
    """A code in brackets is treated alike with any contents."""
    ((index, value),) = parse_line("G[1]").computed
    assert (index, value(known())) == (0, 1.0)


def test_assignments() -> None:
    statement = parse_line("#1=2 #[#2+1] = [#1*3] X5 #<A b>=#1 #<_c>=-.5")
    parameters = known()
    targets = [
        each.target if isinstance(each.target, str) else each.target(parameters)
        for each in statement.assignments
    ]
    assert targets == [1.0, 3.0, "ab", "_c"]
    assert [each.value(parameters) for each in statement.assignments] == [2.0, 3.0, 1.0, -0.5]
    assert [(each.column, each.length) for each in statement.assignments] == [
        (1, 2),
        (6, 7),
        (26, 6),
        (36, 5),
    ]
    assert [word.written for word in statement.words] == ["X5"]


def test_a_macro_assigns_without_brackets() -> None:
    statement = parse_line("#1=#2+3*SQRT[#4] #5 = #3 GT 2", MACRO)
    assert [each.value(known()) for each in statement.assignments] == [8.0, 1.0]


def test_commands_in_comments() -> None:
    statement = parse_line(
        "(msg, Hello ) G0 ( DEBUG ,#1 is %d) (print,a,b) (note, x) (LOGCLOSE) (PY,x) (probeopen "
        "a.txt) (Abort , a) ; (msg, no)"
    )
    assert [(remark.kind, remark.text, remark.column,
        remark.length) for remark in statement.remarks] == [
        ("msg", "Hello", 1, 13), ("debug", "#1 is %d", 18, 18), ("print", "a,b", 37, 11),
            ("logclose", "", 59, 10), ("py", "x", 70, 6),
        ("probeopen", "a.txt", 77, 17), ("abort", "a", 95, 11)
    ]  # fmt: skip


O_WORDS = {
    "o100 sub": ("sub", "100"),
    "O0100 SUB": ("sub", "100"),
    "o 1 00 s u b (deep) ; note": ("sub", "100"),
    "o<Pocket 1> endsub": ("endsub", "<pocket1>"),
    "o100 endsub [#2]": ("endsub", "100", 2.0),
    "o100 return": ("return", "100"),
    "o100 return [1+1]": ("return", "100", 2.0),
    "o100 call": ("call", "100"),
    "o<x> call [#3] [5] [-1]": ("call", "<x>", 3.0, 5.0, -1.0),
    "o#2 call [1]": ("call", 2.0, 1.0),
    "o##2 call": ("call", 2.0),
    "o[#1+1] call [#3]": ("call", 2.0, 3.0),
    "o#<a> call": ("call", 12.0),
    "o1 if [#1 lt 5]": ("if", "1", 1.0),
    "o1 elseif [#1 gt 5]": ("elseif", "1", 0.0),
    "o1 else if [1]": ("elseif", "1", 1.0),
    "o1 else": ("else", "1"),
    "o1 endif": ("endif", "1"),
    "o1 while [#1]": ("while", "1", 1.0),
    "o1 endwhile": ("endwhile", "1"),
    "o1 do": ("do", "1"),
    "o1 repeat [5]": ("repeat", "1", 5.0),
    "o1 endrepeat": ("endrepeat", "1"),
    "o1 break": ("break", "1"),
    "o1 continue": ("continue", "1"),
    "O1234 (PART)": ("program", "1234"),
}
MACRO_LINES = {
    "O1234(PART)": ("program", "1234"),
    "GOTO 10": ("goto", "", 10.0),
    "GOTO#3": ("goto", "", 3.0),
    "GOTO[#3*10]": ("goto", "", 30.0),
    "IF [#1 EQ 1] GOTO 20": ("if-goto", "", 1.0, 20.0),
    "IF[[#1EQ2]OR[#2EQ2]]GOTO#4": ("if-goto", "", 1.0, 4.0),
    "WHILE [#1 LT 5] DO 1": ("while-do", "1", 1.0),
    "DO 2": ("while-do", "2", 1.0),
    "END 2": ("end", "2"),
}


@pytest.mark.parametrize("text", O_WORDS)
def test_o_words(text: str) -> None:
    assert plain(control(text)) == O_WORDS[text]


@pytest.mark.parametrize("text", MACRO_LINES)
def test_macro_statements(text: str) -> None:
    assert plain(control(text, MACRO)) == MACRO_LINES[text]


def test_if_then() -> None:
    found = control("IF [#1 EQ 1] THEN #5 = #1 + 1", MACRO)
    assert plain(found) == ("if-then", "", 1.0)
    assert found.then is not None
    (assignment,) = found.then.assignments
    assert assignment.value(known()) == 2.0


def test_the_place_of_control() -> None:
    statement = parse_line("/ n5 o100  call [1]  (note)")
    assert statement.deletable
    assert [word.written for word in statement.words] == ["N5"]
    assert statement.control is not None
    assert (statement.control.column, statement.control.length) == (6, 10)
    assert control("N5 IF [1] GOTO 3", MACRO).column == 4


def test_block_delete() -> None:
    assert parse_line(" / G0 X1").deletable
    assert parse_line("/2 G0 X1", MACRO).deletable
    assert not parse_line("G0 X1").deletable
    with pytest.raises(GcodeError):
        parse_line("/2 G0 X1", NGC)


def test_percent() -> None:
    assert parse_line("% (a)").percent
    assert parse_line(" %", MACRO).percent
    for syntax in (NGC, MACRO, GRBL):  # with a comment, the grammar reads the line
        assert parse_line("%", syntax) == parse_line(" %\t", syntax) == parse_line("%(a)", syntax)


def test_siemens_words() -> None:
    words = parse_line("BSPLINE SD = 3 X1 pl=[1+1] PW=.7").words
    assert [(word.letter, word.written, word.column, word.length) for word in words] == [
        ("BSPLINE", "BSPLINE", 1, 7), ("SD", "SD=3", 9, 6), ("X", "X1", 16, 2),
            ("PL", "PL=[1+1]", 19, 8), ("PW", "PW=.7", 28, 5)
    ]  # fmt: skip
    assert [word.number for word in words][:3] == [1, 3, 1]
    with pytest.raises(GcodeError) as caught:
        parse_line("G1 SD=3", Syntax("ngc", dialect="linuxcnc"))
    assert str(caught.value).startswith("syntax-not-in-dialect: SD is not in the linuxcnc dialect")


@pytest.mark.parametrize("text", ["$H", " $X ", "$J=G91 X1 F100 (a"])
def test_lines_for_the_board(text: str) -> None:
    assert parse_line(text, GRBL) == Statement(board=text.strip())


@pytest.mark.parametrize("text", ["", "  \t", "(note)", "; note (", "(a ; b) ; c"])
def test_lines_of_comments_only(text: str) -> None:
    assert parse_line(text) == Statement()


def test_each_dialect_has_its_own_statement_of_a_text() -> None:
    assert parse_line("#1=1", NGC) is not parse_line("#1=1", MACRO)
    assert parse_line("#1=1", NGC) is parse_line("#1=1", Syntax("ngc", siemens=True))
